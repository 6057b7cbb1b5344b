defmodule Situ.Bridge.Tcp do
  @moduledoc """
  Sends and receives streams over plain TCP. A frame is a 32-bit length (little-endian) and a message in a format of
  `Situ.Bridge.Format`, as in \\psi's `TcpWriter` and `TcpSource`; any language can read it in three lines of code.

      Situ.Bridge.Tcp.serve(levels, 7000)                         # listens; clients get all messages from now on
      levels = Situ.Bridge.Tcp.connect(p, "robot", 7000)

  A server accepts any number of clients. A slow client loses messages beyond `high_water_mark:`, which are counted;
  it never holds up the stream. If a connection breaks or cannot be established, the client retries after 50 ms to
  5 s; its source never ends. Messages that cannot be read, or whose times do not increase, are dropped and counted
  (`Situ.Pipeline.info/1`). Connections are not authenticated, so a server listens on 127.0.0.1 unless `interface:` is
  given.
  """
  alias Situ.Bridge.Net.{Sink, Source}
  alias Situ.Bridge.Tcp.Frames

  @doc """
  Serves a stream; returns the stream.

  #{Sink.option_docs()}
  """
  @spec serve(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def serve(stream, port, opts \\ []), do: Sink.serve_stream(stream, {Frames, nil}, port, opts)

  @doc "Same as `serve/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def sink(stream, port, opts \\ []), do: serve(stream, port, opts)

  @doc """
  Adds a source with the messages of a server.

  #{Source.option_docs()}
  """
  @spec connect(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def connect(p, host, port, opts \\ []),
    do: Source.connect(p, {Frames, nil}, host, port, opts)

  @doc "Same as `connect/4`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def source(p, host, port, opts \\ []), do: connect(p, host, port, opts)
end
