defmodule Situ.Bridge.ServerSentEvents do
  @moduledoc """
  Streams over HTTP as server-sent events: `curl -N http://localhost:7002`, or in a browser `new EventSource(...)`.

      Situ.Bridge.ServerSentEvents.serve(levels, 7002)
      levels = Situ.Bridge.ServerSentEvents.connect(p, "robot", 7002)

  An event's data is one message in JSON (`Situ.Bridge.Format`). Pages of other sites than this machine's cannot read
  them, for no such permission is sent. Slow clients, broken connections and times are as with `Situ.Bridge.Tcp`.
  There is no encryption and no authentication: a server listens on 127.0.0.1 unless `interface:` says otherwise.
  """
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Net.{Protocol, Sink, Source}
  alias Situ.Bridge.WebSocket.Handshake

  @most_head 16_384

  @doc """
  Serves a stream; returns it.

  #{Sink.docs()}
  """
  @spec serve(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def serve(stream, port, opts \\ []),
    do: Sink.serve(stream, {__MODULE__, nil}, port, [format: :json] ++ opts)

  @doc """
  A source of what a server sends as JSON; `path:` is that of its address (`"/"`). With `format: :raw` any events, as
  the texts of their data.

  #{Source.docs()}
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
        Handshake.refuse("405 Method Not Allowed", "GET only.\n")

      [_] when byte_size(bytes) > @most_head ->
        Handshake.refuse("431 Request Header Fields Too Large", "")

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
  def heard(_bytes, _arg), do: {:ok, "", ""}

  @impl Protocol
  def hello(host, port, path) do
    {"GET #{path} HTTP/1.0\r\nHost: #{host}:#{port}\r\nAccept: text/event-stream\r\n\r\n",
     %{head?: true, rest: ""}}
  end

  @impl Protocol
  def read(bytes, %{head?: true} = state, most) do
    bytes = state.rest <> bytes

    case :binary.split(bytes, "\r\n\r\n") do
      [<<"HTTP/1.", _, " 200", _::binary>>, rest] ->
        read(rest, %{head?: false, rest: ""}, most)

      [head, _] ->
        {:error, "it answers #{inspect(head |> String.split("\r\n") |> hd())}"}

      [_] when byte_size(bytes) > @most_head ->
        {:error, "it does not answer like HTTP"}

      [_] ->
        {:ok, [], "", %{state | rest: bytes}}
    end
  end

  def read(bytes, state, most) do
    {rest, events} = (state.rest <> bytes) |> String.split(~r/\r?\n\r?\n/) |> List.pop_at(-1)

    if byte_size(rest) > most,
      do: {:error, "an event of more than #{most} bytes"},
      else: {:ok, Enum.flat_map(events, &data/1), "", %{state | rest: rest}}
  end

  # Events without data are signs of life.
  defp data(event) do
    case for "data:" <> line <- String.split(event, ~r/\r?\n/),
             do: String.replace_prefix(line, " ", "") do
      [] -> []
      lines -> [Enum.join(lines, "\n")]
    end
  end

  @doc "The name that all bridges have for their way out: `serve/3`."
  @spec sink(Situ.Stream.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def sink(stream, port, opts \\ []), do: serve(stream, port, opts)

  @doc "The name that all bridges have for their way in: `connect/4`."
  @spec source(Situ.Pipeline.t(), String.t(), :inet.port_number(), keyword()) :: Situ.Stream.t()
  def source(p, host, port, opts \\ []), do: connect(p, host, port, opts)
end
