defmodule Situ.Bridge.Tcp do
  @moduledoc """
  Streams over plain TCP: frames of a 32-bit length (little-endian) and a message in a format of `Situ.Bridge.Format`,
  as \\psi's `TcpWriter` and `TcpSource` have it, and as any language reads in three lines.

      Situ.Bridge.Tcp.serve(levels, 7000)                         # listens; every client gets what comes from now on
      levels = Situ.Bridge.Tcp.connect(p, "robot", 7000)

  A server has any number of clients. One that is too slow loses messages, counted, beyond `high_water_mark:`; nobody
  holds up the stream. A client whose connection breaks, or who finds nobody yet, tries again after 50 ms to 5 s; its
  source is endless. Messages that cannot be read, or whose times do not increase, are left out and counted
  (`Situ.Pipeline.info/1`). There is no authentication: a server listens on 127.0.0.1 unless `interface:` says
  otherwise.
  """
  alias Situ.Bridge.Net.{Sink, Source}
  alias Situ.Bridge.Tcp.Frames

  @doc """
  Serves a stream; returns it.

  #{Sink.docs()}
  """
  @spec serve(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def serve(stream, port, opts \\ []), do: Sink.serve(stream, {Frames, nil}, port, opts)

  @doc "The name that all bridges have for their way out: `serve/3`."
  @spec sink(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def sink(stream, port, opts \\ []), do: serve(stream, port, opts)

  @doc """
  A source of what a server sends.

  #{Source.docs()}
  """
  @spec connect(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def connect(p, host, port, opts \\ []),
    do: Source.connect(p, {Frames, nil}, host, port, opts)

  @doc "The name that all bridges have for their way in: `connect/4`."
  @spec source(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def source(p, host, port, opts \\ []), do: connect(p, host, port, opts)
end
