defmodule Situ.CLI.Annotate do
  @moduledoc false
  @behaviour Situ.CLI.Verb
  @impl true
  def verbs, do: []
end
