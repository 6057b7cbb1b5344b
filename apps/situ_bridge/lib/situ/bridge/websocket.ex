defmodule Situ.Bridge.WebSocket do
  @moduledoc """
  Sends and receives streams over WebSockets. Each frame is a message in a format of `Situ.Bridge.Format`: JSON and
  CSV as text, other formats as bytes.

      Situ.Bridge.WebSocket.serve(levels, 7001)                   # clients get all messages from now on
      levels = Situ.Bridge.WebSocket.connect(p, "robot", 7001)

  In a browser: `new WebSocket("ws://localhost:7001").onmessage = e => JSON.parse(e.data).message`. Pages of other
  sites are rejected unless `origins:` lists them. Slow clients, broken connections and times are handled as in
  `Situ.Bridge.Tcp`. Connections are neither encrypted nor authenticated, so a server listens on 127.0.0.1 unless
  `interface:` is given.
  """
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Net.{Protocol, Sink, Source}
  alias Situ.Bridge.WebSocket.{Frames, Handshake}

  @max_client_bytes 65_536

  @doc """
  Serves a stream; returns the stream. `origins:` lists the origins of pages that may connect
  (`["https://example.org"]`).

  #{Sink.option_docs()}
  """
  @spec serve(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def serve(stream, port, opts \\ []) do
    {origins, opts} = Keyword.pop(opts, :origins, [])
    kind = if opts[:format] in [nil, :json, :csv], do: :text, else: :binary
    Sink.serve_stream(stream, {__MODULE__, %{origins: origins, kind: kind}}, port, opts)
  end

  @doc """
  Adds a source with the messages of a server; `path:` is the path of its URL (`"/"`).

  #{Source.option_docs()}
  """
  @spec connect(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def connect(p, host, port, opts \\ []) do
    {path, opts} = Keyword.pop(opts, :path, "/")
    Source.connect(p, {__MODULE__, %{path: path}}, host, port, opts)
  end

  @impl Protocol
  def admit(bytes, arg) do
    with {:ok, reply, _protocol, _path, rest} <-
           Handshake.admit_client(bytes, origins: arg.origins),
         do: {:ok, reply, rest}
  end

  @impl Protocol
  def frame(payload, arg), do: Frames.encode_frame(arg.kind, payload)

  # Messages of clients are dropped; only pings get a reply.
  @impl Protocol
  def handle_bytes(bytes, _arg) do
    case Frames.split_messages(bytes, nil, true, @max_client_bytes) do
      {:ok, events, rest, nil} -> build_reply(events, rest)
      _ -> :close
    end
  end

  defp build_reply(events, rest) do
    if Enum.any?(events, &match?({:close, _}, &1)),
      do: :close,
      else: {:ok, for({:ping, data} <- events, do: Frames.encode_frame(:pong, data)), rest}
  end

  @impl Protocol
  def hello(host, port, arg) do
    {request, key} = Handshake.build_request(host, port, arg.path)
    {request, %{key: key, partial_message: nil, rest: ""}}
  end

  @impl Protocol
  def read(bytes, %{key: key} = state, max) when key != nil do
    case Handshake.check_response(state.rest <> bytes, key) do
      {:ok, rest} -> read(rest, %{state | key: nil, rest: ""}, max)
      :more -> {:ok, [], "", %{state | rest: state.rest <> bytes}}
      error -> error
    end
  end

  def read(bytes, state, max) do
    with {:ok, events, rest, partial_message} <-
           Frames.split_messages(state.rest <> bytes, state.partial_message, false, max) do
      payloads = for {kind, payload} <- events, kind in [:text, :binary], do: payload
      mask = <<0::32>>
      pongs = for {:ping, data} <- events, do: Frames.encode_frame(:pong, data, mask)
      reply = if pongs == [], do: "", else: pongs
      {:ok, payloads, reply, %{state | rest: rest, partial_message: partial_message}}
    end
  end

  @impl Protocol
  def missing_bytes(%{key: nil, rest: rest}), do: Frames.missing_bytes(rest)
  def missing_bytes(_handshake), do: 1

  @doc "Same as `serve/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def sink(stream, port, opts \\ []), do: serve(stream, port, opts)

  @doc "Same as `connect/4`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def source(p, host, port, opts \\ []), do: connect(p, host, port, opts)
end
