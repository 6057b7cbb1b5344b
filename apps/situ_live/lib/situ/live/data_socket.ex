defmodule Situ.Live.DataSocket do
  @moduledoc """
  Binary frames for a browser, many channels on one WebSocket, sent only as far as the browser has asked: signals and pictures.

      defmodule Ticks do
        @behaviour Situ.Live.DataSocket

        @impl true
        def connect(_request, _arg), do: {:ok, %{}}

        @impl true
        def handle_open(channel, %{"name" => name}, state) do
          Source.subscribe(name, {self(), channel})
          {:ok, state}
        end

        @impl true
        def handle_info({:value, channel, time, value}, state) do
          {:push, %{channel: channel, kind: 1, time: time, data: <<value::float-little-64>>}, state}
        end
      end

      routes: [{:socket, "/live/data", Situ.Live.DataSocket, {Ticks, :any_arg}}]

  **Credits.** The browser opens a channel with so many credits and gives more as it draws. A frame pushed without a credit left
  waits: with `queue: :latest` (default) a newer one takes its place, with `queue: n` up to `n` wait and the oldest is
  dropped. So the process never has more than that in memory, and a slow browser never slows what feeds it. Where frames
  are made on demand, `handle_credit/3` tells how many may be sent now. Dropped frames are counted in the frame that follows.

  **On the wire.** To the browser, binary, little-endian, 16 bytes of header, so that `new Float32Array(buffer, 16)` needs no copy:
  `u8 version = 1, u8 kind, u16 dropped, u32 channel, i64 time`, then the data. Text, JSON: `{"op":"opened","ch":n}`,
  `{"op":"error","ch":n,"reason":text}`, `{"op":"closed","ch":n}`, `{"op":"reply","ch":n,"data":...}`, `{"op":"pong"}`.
  From the browser, text, JSON: `{"op":"open","ch":n,"params":{},"credits":k}`, `{"op":"credit","ch":n,"n":k}`,
  `{"op":"msg","ch":n,"params":{}}`, `{"op":"close","ch":n}`, `{"op":"ping"}`. The client is
  `assets/js/data_socket.js`.
  """
  @behaviour Situ.Live.SocketHandler
  alias Situ.Live.DataSocket.Channel
  alias Situ.Live.Json

  @type channel :: 0..4_294_967_295
  @type frame :: %{
          required(:channel) => channel(),
          required(:kind) => 0..255,
          required(:data) => iodata(),
          optional(:time) => integer()
        }
  @type result ::
          {:ok, state :: term()}
          | {:push, frame() | [frame()], state :: term()}
          | {:reply, channel(), term(), state :: term()}
          | {:close, channel(), state :: term()}

  @doc "The browser has connected (host, token and origin are checked)."
  @callback connect(Situ.Live.Request.t(), arg :: term()) ::
              {:ok, state :: term()} | {:error, String.t()}
  @doc "A channel is opened; `queue:` of the options says what waits when credits are out."
  @callback handle_open(channel(), params :: map(), state :: term()) ::
              result()
              | {:ok, state :: term(), [queue: :latest | pos_integer()]}
              | {:error, String.t(), state :: term()}
  @doc "The browser says something on a channel."
  @callback handle_message(channel(), params :: map(), state :: term()) :: result()
  @doc "So many frames may be sent on this channel now."
  @callback handle_credit(channel(), credits :: pos_integer(), state :: term()) :: result()
  @doc "The browser closed the channel; also called for each open one at the end."
  @callback handle_close(channel(), state :: term()) :: {:ok, state :: term()}
  @doc "Any other message to this process."
  @callback handle_info(message :: term(), state :: term()) :: result()
  @optional_callbacks handle_message: 3, handle_credit: 3, handle_close: 2, handle_info: 2

  @max_channels 1_000
  @max_credits 10_000

  defstruct [:module, :state, channels: %{}]

  @impl Situ.Live.SocketHandler
  def init(request, {module, arg}) do
    Code.ensure_loaded(module)

    case module.connect(request, arg) do
      {:ok, state} -> {:ok, %__MODULE__{module: module, state: state}}
      {:error, reason} -> {:error, reason}
    end
  end

  @impl Situ.Live.SocketHandler
  def handle_in({text, opcode: :text}, socket) do
    case Json.decode(text) do
      {:ok, %{"op" => op} = message} -> op(op, message, socket)
      _ -> {:stop, {1007, "not a message of this protocol"}, socket}
    end
  end

  def handle_in({_, opcode: :binary}, socket), do: {:stop, {1003, "text only"}, socket}

  defp op("ping", _, socket), do: {:push, text(%{"op" => "pong"}), socket}

  defp op("open", %{"ch" => ch} = message, socket) when ch in 0..4_294_967_295 do
    cond do
      is_map_key(socket.channels, ch) -> refuse(socket, ch, "channel #{ch} is open")
      map_size(socket.channels) >= @max_channels -> refuse(socket, ch, "too many channels")
      true -> open(socket, ch, params(message), credits(message["credits"]))
    end
  end

  defp op("credit", %{"ch" => ch, "n" => n}, socket) when is_integer(n) and n > 0 do
    case socket.channels do
      %{^ch => channel} ->
        {sent, channel} = Channel.grant(channel, min(n, @max_credits))
        socket = put_in(socket.channels[ch], channel)
        socket |> credit(ch, channel) |> push_more(sent)

      _ ->
        {:ok, socket}
    end
  end

  defp op("msg", %{"ch" => ch} = message, socket) when is_map_key(socket.channels, ch) do
    if function_exported?(socket.module, :handle_message, 3),
      do: result(socket.module.handle_message(ch, params(message), socket.state), socket),
      else: {:ok, socket}
  end

  defp op("close", %{"ch" => ch}, socket) when is_map_key(socket.channels, ch) do
    {:push, text(%{"op" => "closed", "ch" => ch}), closed(socket, ch)}
  end

  # What comes for a channel that was closed meanwhile.
  defp op(op, %{"ch" => _}, socket) when op in ["msg", "close", "credit"], do: {:ok, socket}
  defp op(_, _, socket), do: {:stop, {1007, "not a message of this protocol"}, socket}

  defp params(%{"params" => %{} = params}), do: params
  defp params(_), do: %{}

  defp credits(n) when is_integer(n) and n in 0..@max_credits, do: n
  defp credits(_), do: 1

  defp refuse(socket, ch, reason),
    do: {:push, text(%{"op" => "error", "ch" => ch, "reason" => reason}), socket}

  defp open(socket, ch, params, credits) do
    case socket.module.handle_open(ch, params, socket.state) do
      {:error, reason, state} ->
        refuse(%{socket | state: state}, ch, reason)

      {:ok, state, opts} ->
        opened(%{socket | state: state}, ch, Channel.new(ch, credits, opts), {:ok, state})

      result ->
        opened(socket, ch, Channel.new(ch, credits, []), result)
    end
  end

  defp opened(socket, ch, channel, result) do
    socket = %{socket | channels: Map.put(socket.channels, ch, channel)}
    first = text(%{"op" => "opened", "ch" => ch})

    case result(result, socket) do
      {:ok, socket} -> socket |> credit(ch, socket.channels[ch]) |> push_more([first])
      {:push, frames, socket} -> {:push, [first | List.wrap(frames)], socket}
    end
  end

  # Asked for only where nothing waits: what waits goes first.
  defp credit(socket, ch, %Channel{credits: credits}) when credits > 0 do
    if function_exported?(socket.module, :handle_credit, 3),
      do: result(socket.module.handle_credit(ch, credits, socket.state), socket),
      else: {:ok, socket}
  end

  defp credit(socket, _, _), do: {:ok, socket}

  defp push_more({:ok, socket}, []), do: {:ok, socket}
  defp push_more({:ok, socket}, frames), do: {:push, frames, socket}
  defp push_more({:push, more, socket}, frames), do: {:push, frames ++ List.wrap(more), socket}

  @impl Situ.Live.SocketHandler
  def handle_info(message, socket) do
    if function_exported?(socket.module, :handle_info, 2),
      do: result(socket.module.handle_info(message, socket.state), socket),
      else: {:ok, socket}
  end

  @impl Situ.Live.SocketHandler
  def terminate(_reason, socket) do
    socket.channels |> Map.keys() |> Enum.reduce(socket, &closed(&2, &1))
    :ok
  end

  defp closed(socket, ch) do
    socket = %{socket | channels: Map.delete(socket.channels, ch)}

    if function_exported?(socket.module, :handle_close, 2) do
      {:ok, state} = socket.module.handle_close(ch, socket.state)
      %{socket | state: state}
    else
      socket
    end
  end

  defp result({:ok, state}, socket), do: {:ok, %{socket | state: state}}

  defp result({:push, frames, state}, socket) do
    {out, channels} =
      frames
      |> List.wrap()
      |> Enum.flat_map_reduce(socket.channels, fn %{channel: ch} = frame, channels ->
        case channels do
          %{^ch => channel} ->
            {sent, channel} = Channel.push(channel, frame)
            {sent, %{channels | ch => channel}}

          _ ->
            {[], channels}
        end
      end)

    push_more({:ok, %{socket | state: state, channels: channels}}, out)
  end

  defp result({:reply, ch, data, state}, socket) do
    {:push, text(%{"op" => "reply", "ch" => ch, "data" => data}), %{socket | state: state}}
  end

  defp result({:close, ch, state}, socket) do
    socket = %{socket | state: state, channels: Map.delete(socket.channels, ch)}
    {:push, text(%{"op" => "closed", "ch" => ch}), socket}
  end

  defp text(message), do: {:text, Json.encode(message)}
end
