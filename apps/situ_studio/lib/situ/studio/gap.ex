defmodule Situ.Studio.Gap do
  @moduledoc false
  # Marks the start of a gap, as the data of a message: the live stream was not captured from then
  # on. Nothing is drawn.
  defstruct []

  @type t :: %__MODULE__{}
end
