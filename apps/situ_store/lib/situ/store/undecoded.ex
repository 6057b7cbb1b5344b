defmodule Situ.Store.Undecoded do
  @moduledoc """
  A message whose bytes could not be made data of: an unknown codec, bytes its codec refuses, or a term that is not
  plain data.

  `bytes` are what was stored (`nil` for a term that was refused), `codec` the codec's name, `reason` a sentence.
  """
  defstruct [:codec, :bytes, :reason]
  @type t :: %__MODULE__{codec: String.t() | nil, bytes: binary() | nil, reason: String.t()}
end
