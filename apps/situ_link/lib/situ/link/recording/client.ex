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
  @reply_ms 60_000
  @retry_ms 1_000
  # The longest reply: one message, or several megabytes of messages.
  @max_reply 1024 * 1024 * 1024 + 65_536

  # `pending` maps ids to `{:call, from, params}` or `{:await, params, {pid, tag}}`, each with its timer. `parts`
  # holds the parts of incomplete replies.
  defstruct [
    :address,
    :access,
    :socket,
    :dialer,
    queued: [],
    pending: %{},
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
  def fetch_reply(address, access, params), do: call_client(address, access, {:ask, params})

  @doc "Sends `{:situ_store, tag, notice}` to `pid` once the recording grows or ends, even if the link is lost before."
  @spec await_notice(Address.t(), Access.t(), map(), {pid(), non_neg_integer()}) :: :ok
  def await_notice(address, access, params, to) do
    {:ok, pid} = find_or_start(address, access)
    GenServer.cast(pid, {:await, params, to})
  end

  defp call_client(address, access, request, tries \\ 3) do
    {:ok, pid} = find_or_start(address, access)
    GenServer.call(pid, request, :infinity)
  catch
    # The process was ending because it was idle, so the call starts a new one.
    :exit, {reason, _} when reason in [:normal, :noproc] and tries > 1 ->
      call_client(address, access, request, tries - 1)
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
  def handle_call({:ask, params}, from, state),
    do: {:noreply, begin_request(state, {:call, from, params})}

  @impl true
  def handle_cast({:await, params, {pid, _} = to}, state) do
    Process.monitor(pid)
    {:noreply, begin_request(state, {:await, params, to})}
  end

  # Sends the request if there is a connection. Otherwise it is queued, and the connection is opened first.
  defp begin_request(%{socket: nil} = state, request),
    do: start_dialer(%{state | queued: [request | state.queued]})

  defp begin_request(state, request) do
    id = state.next
    frame = {:request, id, request_map(request)}
    timer = Process.send_after(self(), {:late, id}, @reply_ms)
    _ = Socket.send(state.socket, Frame.encode(frame))
    pending = Map.put(state.pending, id, {request, timer})
    %{state | next: rem(id, 0x7FFFFFFF) + 1, pending: pending}
  end

  defp request_map({:call, _from, params}), do: params
  defp request_map({:await, params, _to}), do: params

  defp start_dialer(%{dialer: nil} = state) do
    %{state | dialer: Dialer.start_dialer(state.address, state.access)}
  end

  defp start_dialer(state), do: state

  @impl true
  def handle_info({:dialed, dialer, {:ok, socket, _welcome}}, %{dialer: dialer} = state) do
    case Socket.enable_frames(socket, Dialer.max_bytes()) do
      :ok ->
        queued = Enum.reverse(state.queued)
        state = %{state | socket: socket, dialer: nil, queued: []}
        noreply_or_idle(Enum.reduce(queued, state, &begin_request(&2, &1)))

      {:error, reason} ->
        handle_link_loss(%{state | socket: socket}, Socket.reason_text(reason))
    end
  end

  def handle_info({:dialed, dialer, {:error, error}}, %{dialer: dialer} = state) do
    {awaiting, others} = Enum.split_with(state.queued, &match?({:await, _, _}, &1))
    for request <- others, do: deliver_result(request, {:error, error})
    noreply_or_idle(schedule_reconnect(%{state | dialer: nil, queued: awaiting}))
  end

  def handle_info(:dial, %{socket: nil} = state), do: {:noreply, start_dialer(state)}

  def handle_info({kind, socket, body}, %{socket: {_, socket}} = state)
      when kind in [:tcp, :ssl] do
    _ = Socket.activate_once(state.socket)

    case Frame.decode(body) do
      {:ok, {:reply, id, part}} ->
        noreply_or_idle(handle_reply_part(state, id, part))

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

  # Only calls time out. A request that awaits a notice may take any time.
  def handle_info({:late, id}, state) do
    case state.pending do
      %{^id => {{:call, _, _}, _}} ->
        handle_link_loss(state, "no reply within #{div(@reply_ms, 1_000)} s")

      _ ->
        noreply_or_idle(state)
    end
  end

  def handle_info({:DOWN, _, :process, pid, _}, state) do
    from_pid? = &match?({:await, _, {^pid, _}}, &1)
    pending = Map.reject(state.pending, fn {_, {request, _}} -> from_pid?.(request) end)
    noreply_or_idle(%{state | pending: pending, queued: Enum.reject(state.queued, from_pid?)})
  end

  def handle_info(:timeout, %{pending: pending, queued: []} = state)
      when map_size(pending) == 0,
      do: {:stop, :normal, state}

  def handle_info(_other, state), do: noreply_or_idle(state)

  # When no request is pending, the idle timeout begins.
  defp noreply_or_idle(%{pending: pending, queued: [], dialer: nil} = state)
       when map_size(pending) == 0,
       do: {:noreply, state, @idle_ms}

  defp noreply_or_idle(state), do: {:noreply, state}

  defp handle_reply_part(state, id, <<0, bytes::binary>>) when is_map_key(state.pending, id) do
    {size, parts} = Map.get(state.parts, id, {0, []})
    size = size + byte_size(bytes)

    if size > @max_reply,
      do:
        finish_request(
          state,
          id,
          {:error, Error.new(:bad_reply, "the reply is larger than 1 GiB")}
        ),
      else: %{state | parts: Map.put(state.parts, id, {size, [parts, bytes]})}
  end

  defp handle_reply_part(state, id, <<1, bytes::binary>>) when is_map_key(state.pending, id) do
    body =
      case state.parts do
        %{^id => {_, parts}} -> IO.iodata_to_binary([parts, bytes])
        _ -> bytes
      end

    finish_request(state, id, {:ok, body})
  end

  defp handle_reply_part(state, id, <<2, json::binary>>) when is_map_key(state.pending, id) do
    map = with {:ok, %{} = map} <- JSON.decode(json), do: map, else: (_ -> %{})
    finish_request(state, id, {:error, Handshake.error_from_map(map)})
  end

  defp handle_reply_part(state, _id, _part), do: state

  defp finish_request(state, id, result) do
    {{request, timer}, pending} = Map.pop(state.pending, id)
    _ = Process.cancel_timer(timer)
    deliver_result(request, result)
    %{state | pending: pending, parts: Map.delete(state.parts, id)}
  end

  defp deliver_result({:call, from, _params}, result), do: GenServer.reply(from, result)

  defp deliver_result({:await, %{"known" => known}, {pid, tag}}, result) do
    with {:ok, body} <- result, {:ok, notice} <- ReplyDecoder.decode_notice(body) do
      send(pid, {:situ_store, tag, notice})
    else
      # The server no longer has the recording.
      _ -> send(pid, {:situ_store, tag, {:ended, known}})
    end
  end

  # When the link is lost, requests that await a notice are kept and sent again. All other requests return an error.
  defp handle_link_loss(state, why) do
    if state.socket, do: Socket.close(state.socket)
    address = Address.to_string(state.address)
    error = Error.new(:link_lost, "the link to #{address} was lost", why: why)

    awaiting =
      Enum.flat_map(state.pending, fn {_, {request, timer}} ->
        _ = Process.cancel_timer(timer)

        if match?({:await, _, _}, request) do
          [request]
        else
          deliver_result(request, {:error, error})
          []
        end
      end)

    noreply_or_idle(
      schedule_reconnect(%{state | socket: nil, pending: %{}, parts: %{}, queued: awaiting})
    )
  end

  defp schedule_reconnect(%{queued: []} = state), do: state

  defp schedule_reconnect(state) do
    Process.send_after(self(), :dial, @retry_ms)
    state
  end

  @impl true
  def terminate(_reason, state), do: if(state.socket, do: Socket.close(state.socket))
end
