defmodule Situ.Bridge.Net.Protocol do
  @moduledoc false
  # How messages are encoded on a connection. Pure: bytes in, bytes out. A protocol is given as `{module, arg}`; `arg`
  # holds its settings.

  @typedoc "The protocol's state for one connection."
  @type state :: term()

  @doc """
  Checks the first bytes of a client on the server (`""` before any arrived). Returns the reply to an admitted client,
  `:more` if more bytes are needed, or the last bytes to send to a refused client.
  """
  @callback admit(bytes :: binary(), arg :: term()) ::
              {:ok, reply :: iodata(), rest :: binary()} | :more | {:refuse, reply :: iodata()}
  @doc "Encodes one message for a client."
  @callback frame(payload :: iodata(), arg :: term()) :: iodata()
  @doc "Handles bytes of an admitted client; returns the reply and the remaining bytes, or `:close` if it disconnects."
  @callback handle_bytes(bytes :: binary(), arg :: term()) ::
              {:ok, reply :: iodata(), binary()} | :close

  @doc "Returns a client's first bytes and its state."
  @callback hello(host :: String.t(), port :: :inet.port_number(), arg :: term()) ::
              {iodata(), state()}
  @doc "Same as `hello/3` for a later connection, with the state of the previous one. Default: `hello/3`."
  @callback resume(host :: String.t(), port :: :inet.port_number(), state()) ::
              {iodata(), state()}
  @doc "Returns whether the server has worked on this connection, even without payloads. Default: false."
  @callback progress?(state()) :: boolean()
  @doc "Returns the last bytes before the client closes the connection."
  @callback goodbye(state()) :: iodata()
  @doc """
  Parses bytes of a server; returns the complete payloads (each at most `max` bytes), a reply, and the state.
  `:reconnect` closes the connection and keeps the state for the next one.
  """
  @callback read(bytes :: binary(), state(), max :: pos_integer()) ::
              {:ok, [Situ.Bridge.PayloadDecoder.payload()], reply :: iodata(), state()}
              | {:error, String.t()}
              | {:reconnect, why :: term(), state()}

  @doc "Returns the interval between two pings, ms (0: none), and a ping to which the server replies. Default: none."
  @callback keep_alive(state()) :: {interval_ms :: non_neg_integer(), ping :: iodata()}
  @doc "Returns the minimum number of bytes that `read/3` needs to return a payload, or 1 if that is unknown."
  @callback missing_bytes(state()) :: pos_integer()

  # A protocol that is only used by clients lacks the server's callbacks.
  @optional_callbacks admit: 2,
                      frame: 2,
                      handle_bytes: 2,
                      missing_bytes: 1,
                      resume: 3,
                      goodbye: 1,
                      keep_alive: 1,
                      progress?: 1
end
