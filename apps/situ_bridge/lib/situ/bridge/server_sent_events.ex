defmodule Situ.Bridge.ServerSentEvents do
  @moduledoc """
  Sends and receives streams over HTTP as server-sent events. Clients can be `curl -N http://localhost:7002`, or
  `new EventSource(...)` in a browser.

      Situ.Bridge.ServerSentEvents.serve(levels, 7002)
      levels = Situ.Bridge.ServerSentEvents.connect(p, "robot", 7002)

  The data of an event is one message in JSON (`Situ.Bridge.Format`). Pages of other sites cannot read the events,
  since the server sends no CORS headers. Slow clients, broken connections and times are handled as in
  `Situ.Bridge.Tcp`. Connections are neither encrypted nor authenticated, so a server listens on 127.0.0.1 unless
  `interface:` is given.
  """
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Net.{Protocol, Sink, Source}
  alias Situ.Bridge.WebSocket.Handshake

  @max_head 16_384

  @doc """
  Serves a stream; returns the stream.

  #{Sink.option_docs()}
  """
  @spec serve(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def serve(stream, port, opts \\ []),
    do: Sink.serve_stream(stream, {__MODULE__, nil}, port, [format: :json] ++ opts)

  @doc """
  Adds a source with the JSON messages of a server; `path:` is the path of its URL (`"/"`). With `format: :raw` it
  accepts any events and emits their data as strings.

  #{Source.option_docs()}
  """
  @spec connect(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def connect(p, host, port, opts \\ []) do
    {path, opts} = Keyword.pop(opts, :path, "/")
    Source.connect(p, {__MODULE__, path}, host, port, opts)
  end

  @impl Protocol
  def admit(bytes, _arg) do
    case :binary.split(bytes, "\r\n\r\n") do
      [<<"GET ", _::binary>>, rest] ->
        head = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n"
        {:ok, [head, "Connection: close\r\n\r\n"], rest}

      [_, _] ->
        Handshake.refuse_request("405 Method Not Allowed", "GET only.\n")

      [_] when byte_size(bytes) > @max_head ->
        Handshake.refuse_request("431 Request Header Fields Too Large", "")

      [_] ->
        :more
    end
  end

  @impl Protocol
  def frame(payload, _arg) do
    lines = payload |> IO.iodata_to_binary() |> String.split("\n")
    [Enum.map(lines, &["data: ", &1, "\n"]), "\n"]
  end

  @impl Protocol
  def handle_bytes(_bytes, _arg), do: {:ok, "", ""}

  @impl Protocol
  def hello(host, port, path) do
    {"GET #{path} HTTP/1.0\r\nHost: #{host}:#{port}\r\nAccept: text/event-stream\r\n\r\n",
     %{head?: true, rest: ""}}
  end

  @impl Protocol
  def read(bytes, %{head?: true} = state, max) do
    bytes = state.rest <> bytes

    case :binary.split(bytes, "\r\n\r\n") do
      [<<"HTTP/1.", _, " 200", _::binary>>, rest] ->
        read(rest, %{head?: false, rest: ""}, max)

      [head, _] ->
        {:error, "the response is #{inspect(head |> String.split("\r\n") |> hd())}"}

      [_] when byte_size(bytes) > @max_head ->
        {:error, "the response is not HTTP"}

      [_] ->
        {:ok, [], "", %{state | rest: bytes}}
    end
  end

  def read(bytes, state, max) do
    {rest, events} = (state.rest <> bytes) |> String.split(~r/\r?\n\r?\n/) |> List.pop_at(-1)

    if byte_size(rest) > max,
      do: {:error, "an event is longer than #{max} bytes"},
      else: {:ok, Enum.flat_map(events, &event_data/1), "", %{state | rest: rest}}
  end

  # Events without data only keep the connection alive.
  defp event_data(event) do
    case for "data:" <> line <- String.split(event, ~r/\r?\n/),
             do: String.replace_prefix(line, " ", "") do
      [] -> []
      lines -> [Enum.join(lines, "\n")]
    end
  end

  @doc "Same as `serve/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def sink(stream, port, opts \\ []), do: serve(stream, port, opts)

  @doc "Same as `connect/4`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def source(p, host, port, opts \\ []), do: connect(p, host, port, opts)
end
