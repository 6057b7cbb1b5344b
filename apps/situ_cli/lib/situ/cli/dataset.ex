defmodule Situ.CLI.Dataset do
  @moduledoc false
  @behaviour Situ.CLI.Verb
  @impl true
  def verbs, do: []
end
