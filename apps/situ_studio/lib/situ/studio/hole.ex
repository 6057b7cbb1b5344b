defmodule Situ.Studio.Hole do
  @moduledoc """
  Stands in a message for what nobody saw: a live stream that no page was looking at. Nothing is drawn of it.
  """
  defstruct []

  @type t :: %__MODULE__{}
end
