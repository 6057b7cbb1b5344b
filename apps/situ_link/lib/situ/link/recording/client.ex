defmodule Situ.Link.Recording.Client do
  @moduledoc false
  # Reads the recordings of one server in one process. It sends requests and receives replies over one connection.
  # It starts at the first request and ends after a period without requests, so an open recording needs no closing.
  use GenServer, restart: :temporary
  alias Situ.{Error, JSON}
  alias Situ.Link.{Access, Address}
  alias Situ.Link.Wire.{Dialer, Frame, Handshake, Socket}
  alias Situ.Link.Recording.ReplyDecoder

  @registry Situ.Link.Recording.Registry
  @supervisor Situ.Link.Recording.Supervisor
  @idle_ms 60_000
  @answer_ms 60_000
  @again_ms 1_000
  # The longest reply: one message, or several megabytes of messages.
  @most_answer 1024 * 1024 * 1024 + 65_536

  # `under_way` maps ids to `{:call, from}` or `{:await, asked, {pid, tag}}`. `parts` holds the parts of incomplete
  # replies.
  defstruct [
    :address,
    :access,
    :socket,
    :dialer,
    queued: [],
    under_way: %{},
    parts: %{},
    next: 1
  ]

  @spec child_specs() :: [Supervisor.child_spec() | {module(), keyword()}]
  def child_specs do
    [
      {Registry, keys: :unique, name: @registry},
      {DynamicSupervisor, name: @supervisor, strategy: :one_for_one}
    ]
  end

  @doc "Sends a request and returns the body of the reply. Errors: the server's own, `:unreachable`, `:link_lost` ..."
  @spec fetch_reply(Address.t(), Access.t(), map()) :: {:ok, binary()} | {:error, Error.t()}
  def fetch_reply(address, access, asked), do: call_client(address, access, {:ask, asked})

  @doc "Sends `{:situ_store, tag, news}` to `pid` once there is news. It survives the loss of the link."
  @spec await_news(Address.t(), Access.t(), map(), {pid(), non_neg_integer()}) :: :ok
  def await_news(address, access, asked, to) do
    {:ok, pid} = find_or_start(address, access)
    GenServer.cast(pid, {:await, asked, to})
  end

  defp call_client(address, access, question, tries \\ 3) do
    {:ok, pid} = find_or_start(address, access)
    GenServer.call(pid, question, :infinity)
  catch
    # The process was ending because it was idle, so the call starts a new one.
    :exit, {reason, _} when reason in [:normal, :noproc] and tries > 1 ->
      call_client(address, access, question, tries - 1)
  end

  defp find_or_start(address, access) do
    key = {address, %{access | token: Handshake.hide_token(access.token)}}

    case Registry.whereis_name({@registry, key}) do
      :undefined ->
        name = {:via, Registry, {@registry, key}}
        start = {GenServer, :start_link, [__MODULE__, key, [name: name]]}
        spec = %{id: __MODULE__, start: start, restart: :temporary}

        case DynamicSupervisor.start_child(@supervisor, spec) do
          {:ok, pid} -> {:ok, pid}
          {:error, {:already_started, pid}} -> {:ok, pid}
        end

      pid ->
        {:ok, pid}
    end
  end

  @impl true
  def init({address, access}) do
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{address: address, access: access}, @idle_ms}
  end

  @impl true
  def handle_call({:ask, asked}, from, state),
    do: {:noreply, begin_request(state, {:call, from, asked})}

  @impl true
  def handle_cast({:await, asked, {pid, _} = to}, state) do
    Process.monitor(pid)
    {:noreply, begin_request(state, {:await, asked, to})}
  end

  # Sends the request if there is a connection. Otherwise it is queued, and the connection is opened first.
  defp begin_request(%{socket: nil} = state, question),
    do: start_dialer(%{state | queued: [question | state.queued]})

  defp begin_request(state, question) do
    id = state.next
    frame = {:request, id, request_map(question)}
    timer = Process.send_after(self(), {:late, id}, @answer_ms)
    _ = Socket.send(state.socket, Frame.encode(frame))
    under_way = Map.put(state.under_way, id, {question, timer})
    %{state | next: rem(id, 0x7FFFFFFF) + 1, under_way: under_way}
  end

  defp request_map({:call, _from, asked}), do: asked
  defp request_map({:await, asked, _to}), do: asked

  defp start_dialer(%{dialer: nil} = state) do
    %{state | dialer: Dialer.start_dialer(state.address, state.access)}
  end

  defp start_dialer(state), do: state

  @impl true
  def handle_info({:dialed, dialer, {:ok, socket, _welcome}}, %{dialer: dialer} = state) do
    case Socket.enable_frames(socket, Dialer.most_bytes()) do
      :ok ->
        queued = Enum.reverse(state.queued)
        state = %{state | socket: socket, dialer: nil, queued: []}
        noreply_or_idle(Enum.reduce(queued, state, &begin_request(&2, &1)))

      {:error, reason} ->
        handle_link_loss(%{state | socket: socket}, Socket.reason_text(reason))
    end
  end

  def handle_info({:dialed, dialer, {:error, error}}, %{dialer: dialer} = state) do
    {waiting, others} = Enum.split_with(state.queued, &match?({:await, _, _}, &1))
    for question <- others, do: deliver_result(question, {:error, error})
    noreply_or_idle(schedule_reconnect(%{state | dialer: nil, queued: waiting}))
  end

  def handle_info(:dial, %{socket: nil} = state), do: {:noreply, start_dialer(state)}

  def handle_info({kind, socket, body}, %{socket: {_, socket}} = state)
      when kind in [:tcp, :ssl] do
    _ = Socket.activate_once(state.socket)

    case Frame.decode(body) do
      {:ok, {:reply, id, piece}} ->
        noreply_or_idle(handle_reply_part(state, id, piece))

      {:ok, {:refused, map}} ->
        handle_link_loss(state, map |> Handshake.error_from_map() |> Exception.message())

      # The server also sends the catalogue, which is not needed here.
      {:ok, _other} ->
        noreply_or_idle(state)

      {:error, why} ->
        handle_link_loss(state, why)
    end
  end

  def handle_info({kind, socket}, %{socket: {_, socket}} = state)
      when kind in [:tcp_closed, :ssl_closed],
      do: handle_link_loss(state, "the other side closed the connection")

  def handle_info({kind, socket, reason}, %{socket: {_, socket}} = state)
      when kind in [:tcp_error, :ssl_error],
      do: handle_link_loss(state, Socket.reason_text(reason))

  # Only calls time out. A request that awaits news may take any time.
  def handle_info({:late, id}, state) do
    case state.under_way do
      %{^id => {{:call, _, _}, _}} ->
        handle_link_loss(state, "no reply within #{div(@answer_ms, 1_000)} s")

      _ ->
        noreply_or_idle(state)
    end
  end

  def handle_info({:DOWN, _, :process, pid, _}, state) do
    mine? = &match?({:await, _, {^pid, _}}, &1)
    under_way = Map.reject(state.under_way, fn {_, {question, _}} -> mine?.(question) end)
    noreply_or_idle(%{state | under_way: under_way, queued: Enum.reject(state.queued, mine?)})
  end

  def handle_info(:timeout, %{under_way: under_way, queued: []} = state)
      when map_size(under_way) == 0,
      do: {:stop, :normal, state}

  def handle_info(_other, state), do: noreply_or_idle(state)

  # When no request is pending, the idle timeout begins.
  defp noreply_or_idle(%{under_way: under_way, queued: [], dialer: nil} = state)
       when map_size(under_way) == 0,
       do: {:noreply, state, @idle_ms}

  defp noreply_or_idle(state), do: {:noreply, state}

  defp handle_reply_part(state, id, <<0, bytes::binary>>) when is_map_key(state.under_way, id) do
    {size, parts} = Map.get(state.parts, id, {0, []})
    size = size + byte_size(bytes)

    if size > @most_answer,
      do:
        finish_request(
          state,
          id,
          {:error, Error.new(:bad_reply, "the reply is larger than 1 GiB")}
        ),
      else: %{state | parts: Map.put(state.parts, id, {size, [parts, bytes]})}
  end

  defp handle_reply_part(state, id, <<1, bytes::binary>>) when is_map_key(state.under_way, id) do
    body =
      case state.parts do
        %{^id => {_, parts}} -> IO.iodata_to_binary([parts, bytes])
        _ -> bytes
      end

    finish_request(state, id, {:ok, body})
  end

  defp handle_reply_part(state, id, <<2, json::binary>>) when is_map_key(state.under_way, id) do
    map = with {:ok, %{} = map} <- JSON.decode(json), do: map, else: (_ -> %{})
    finish_request(state, id, {:error, Handshake.error_from_map(map)})
  end

  defp handle_reply_part(state, _id, _piece), do: state

  defp finish_request(state, id, result) do
    {{question, timer}, under_way} = Map.pop(state.under_way, id)
    _ = Process.cancel_timer(timer)
    deliver_result(question, result)
    %{state | under_way: under_way, parts: Map.delete(state.parts, id)}
  end

  defp deliver_result({:call, from, _asked}, result), do: GenServer.reply(from, result)

  defp deliver_result({:await, %{"known" => known}, {pid, tag}}, result) do
    with {:ok, body} <- result, {:ok, news} <- ReplyDecoder.decode_news(body) do
      send(pid, {:situ_store, tag, news})
    else
      # The server no longer has the recording.
      _ -> send(pid, {:situ_store, tag, {:ended, known}})
    end
  end

  # When the link is lost, requests that await news are kept and sent again. All other requests return an error.
  defp handle_link_loss(state, why) do
    if state.socket, do: Socket.close(state.socket)
    where = Address.to_string(state.address)
    error = Error.new(:link_lost, "the link to #{where} was lost", why: why)

    waiting =
      Enum.flat_map(state.under_way, fn {_, {question, timer}} ->
        _ = Process.cancel_timer(timer)

        if match?({:await, _, _}, question) do
          [question]
        else
          deliver_result(question, {:error, error})
          []
        end
      end)

    noreply_or_idle(
      schedule_reconnect(%{state | socket: nil, under_way: %{}, parts: %{}, queued: waiting})
    )
  end

  defp schedule_reconnect(%{queued: []} = state), do: state

  defp schedule_reconnect(state) do
    Process.send_after(self(), :dial, @again_ms)
    state
  end

  @impl true
  def terminate(_reason, state), do: if(state.socket, do: Socket.close(state.socket))
end
