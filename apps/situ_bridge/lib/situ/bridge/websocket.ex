defmodule Situ.Bridge.WebSocket do
  @moduledoc """
  Streams over WebSockets: one message each, in a format of `Situ.Bridge.Format`; JSON as text, other formats as bytes.

      Situ.Bridge.WebSocket.serve(levels, 7001)                   # every client gets what comes from now on
      levels = Situ.Bridge.WebSocket.connect(p, "robot", 7001)

  In a browser: `new WebSocket("ws://localhost:7001").onmessage = e => JSON.parse(e.data).message`. Pages of other
  sites than this machine's are refused unless `origins:` names them. Slow clients, broken connections and times are
  as with `Situ.Bridge.Tcp`. There is no encryption and no authentication: a server listens on 127.0.0.1 unless
  `interface:` says otherwise.
  """
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Net.{Protocol, Sink, Source}
  alias Situ.Bridge.WebSocket.{Frames, Handshake}

  @most_said 65_536

  @doc """
  Serves a stream; returns it. `origins:` are those of pages that may connect (`["https://example.org"]`).

  #{Sink.docs()}
  """
  @spec serve(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def serve(stream, port, opts \\ []) do
    {origins, opts} = Keyword.pop(opts, :origins, [])
    kind = if opts[:format] in [nil, :json, :csv], do: :text, else: :binary
    Sink.serve(stream, {__MODULE__, %{origins: origins, kind: kind}}, port, opts)
  end

  @doc """
  A source of what a server sends; `path:` is that of its address (`"/"`).

  #{Source.docs()}
  """
  @spec connect(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def connect(p, host, port, opts \\ []) do
    {path, opts} = Keyword.pop(opts, :path, "/")
    Source.connect(p, {__MODULE__, %{path: path}}, host, port, opts)
  end

  @impl Protocol
  def admit(bytes, arg) do
    with {:ok, answer, _protocol, _path, rest} <- Handshake.admit(bytes, origins: arg.origins),
         do: {:ok, answer, rest}
  end

  @impl Protocol
  def frame(payload, arg), do: Frames.frame(arg.kind, payload)

  # Messages of clients are dropped; only their pings get answers.
  @impl Protocol
  def heard(bytes, _arg) do
    case Frames.split(bytes, nil, true, @most_said) do
      {:ok, events, rest, nil} -> answered(events, rest)
      _ -> :close
    end
  end

  defp answered(events, rest) do
    if Enum.any?(events, &match?({:close, _}, &1)),
      do: :close,
      else: {:ok, for({:ping, data} <- events, do: Frames.frame(:pong, data)), rest}
  end

  @impl Protocol
  def hello(host, port, arg) do
    {request, key} = Handshake.request(host, port, arg.path)
    {request, %{key: key, begun: nil, rest: ""}}
  end

  @impl Protocol
  def read(bytes, %{key: key} = state, most) when key != nil do
    case Handshake.accepted(state.rest <> bytes, key) do
      {:ok, rest} -> read(rest, %{state | key: nil, rest: ""}, most)
      :more -> {:ok, [], "", %{state | rest: state.rest <> bytes}}
      error -> error
    end
  end

  def read(bytes, state, most) do
    with {:ok, events, rest, begun} <- Frames.split(state.rest <> bytes, state.begun, false, most) do
      payloads = for {kind, payload} <- events, kind in [:text, :binary], do: payload
      mask = <<0::32>>
      pongs = for {:ping, data} <- events, do: Frames.frame(:pong, data, mask)
      answer = if pongs == [], do: "", else: pongs
      {:ok, payloads, answer, %{state | rest: rest, begun: begun}}
    end
  end

  @impl Protocol
  def missing(%{key: nil, rest: rest}), do: Frames.missing(rest)
  def missing(_handshake), do: 1

  @doc "The name that all bridges have for their way out: `serve/3`."
  @spec sink(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def sink(stream, port, opts \\ []), do: serve(stream, port, opts)

  @doc "The name that all bridges have for their way in: `connect/4`."
  @spec source(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def source(p, host, port, opts \\ []), do: connect(p, host, port, opts)
end
