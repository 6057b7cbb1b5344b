defmodule Situ.Bridge.Net.Protocol do
  @moduledoc false
  # How messages travel on one connection. Pure: bytes in, bytes out; `arg` is what the protocol was set up with. A
  # protocol is given as `{module, arg}`.

  @typedoc "The protocol's state of one connection."
  @type state :: term()

  @doc """
  A server looks at the first bytes of a client (`""` before any came): it may be served, and is answered so; more is
  needed; or it is sent off with some last words.
  """
  @callback admit(bytes :: binary(), arg :: term()) ::
              {:ok, answer :: iodata(), rest :: binary()} | :more | {:refuse, answer :: iodata()}
  @doc "One message as a server sends it."
  @callback frame(payload :: iodata(), arg :: term()) :: iodata()
  @doc "Bytes of a client that is being served: the answer and the rest of the bytes, or `:close` if it ends."
  @callback heard(bytes :: binary(), arg :: term()) ::
              {:ok, answer :: iodata(), binary()} | :close

  @doc "A client's first bytes, and its state."
  @callback hello(host :: String.t(), port :: :inet.port_number(), arg :: term()) ::
              {iodata(), state()}
  @doc "Bytes of a server: the complete payloads, an answer, and the state; no payload may exceed `most` bytes."
  @callback read(bytes :: binary(), state(), most :: pos_integer()) ::
              {:ok, [binary()], answer :: iodata(), state()} | {:error, String.t()}

  @doc "How many bytes `read/3` misses at least before it can give a payload; 1 where that is not known."
  @callback missing(state()) :: pos_integer()

  # A protocol that we only dial has no server's side.
  @optional_callbacks admit: 2, frame: 2, heard: 2, missing: 1
end
