defmodule Situ.Studio.Gap do
  @moduledoc """
  The data of a message that marks a gap: the live stream was not captured from then on. Nothing is drawn for it.
  """
  defstruct []

  @type t :: %__MODULE__{}
end
