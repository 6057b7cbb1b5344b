defmodule Situ.Store.Undecoded do
  @moduledoc """
  The data of a message that could not be decoded, because its codec is unknown, its codec rejected the bytes, or its
  term is not plain data. Reading a recording continues with the next message.

      case message.data do
        %Situ.Store.Undecoded{reason: reason} -> IO.puts(reason)
        data -> use_data(data)
      end

    * `bytes`: the stored bytes; `nil` for a rejected term
    * `codec`: the codec's name, or `nil`
    * `reason`: a sentence
  """
  defstruct [:codec, :bytes, :reason]
  @type t :: %__MODULE__{codec: String.t() | nil, bytes: binary() | nil, reason: String.t()}
end
