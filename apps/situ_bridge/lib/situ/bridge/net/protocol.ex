defmodule Situ.Bridge.Net.Protocol do
  @moduledoc false
  # How messages travel on one connection. Pure: bytes in, bytes out; `arg` is what the protocol was set up with. A
  # protocol is given as `{module, arg}`.

  @typedoc "What a protocol remembers of one connection."
  @type state :: term()

  @doc """
  A server looks at the first bytes of a client (`""` before any came): it may be served, and is answered so; more is
  needed; or it is sent off with some last words.
  """
  @callback admit(bytes :: binary(), arg :: term()) ::
              {:ok, answer :: iodata(), rest :: binary()} | :more | {:refuse, answer :: iodata()}
  @doc "One message as a server sends it."
  @callback frame(payload :: iodata(), arg :: term()) :: iodata()
  @doc "What a client says once it is served: an answer and what is left, or it wants to end."
  @callback heard(bytes :: binary(), arg :: term()) ::
              {:ok, answer :: iodata(), binary()} | :close

  @doc "What a client says first, and its state."
  @callback hello(host :: String.t(), port :: :inet.port_number(), arg :: term()) ::
              {iodata(), state()}
  @doc "What a server sent: whole payloads, an answer, and the state; no payload may be longer than `most` bytes."
  @callback read(bytes :: binary(), state(), most :: pos_integer()) ::
              {:ok, [binary()], answer :: iodata(), state()} | {:error, String.t()}
end
