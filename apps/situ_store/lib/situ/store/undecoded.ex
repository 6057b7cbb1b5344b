defmodule Situ.Store.Undecoded do
  @moduledoc false
  # A message that could not be decoded, because its codec is unknown, its codec rejected the
  # bytes, or its term is not plain data.
  #
  # `bytes` are the stored bytes (`nil` for a rejected term), `codec` is the codec's name, and
  # `reason` is a sentence.
  defstruct [:codec, :bytes, :reason]
  @type t :: %__MODULE__{codec: String.t() | nil, bytes: binary() | nil, reason: String.t()}
end
