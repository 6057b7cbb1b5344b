defmodule Situ.Link.Connection do
  @moduledoc false
  # Represents a link as one process of a pipeline. It keeps a connection to the server, receives the catalogue, and
  # passes messages to the components of the streams. After a reconnect it resumes each stream at its last position.
  use GenServer
  alias Situ.Link.Address
  alias Situ.Link.Wire.{ClockEstimate, Dialer, Frame, Socket}

  alias Situ.Link.Connection.{
    Catalogue,
    Channel,
    DatagramReceiver,
    FrameHandler,
    LinkInfo,
    Positions
  }

  require Logger

  @min_wait_ms 50
  @max_wait_ms 5_000
  @ping_ms 1_000
  @first_pings 8
  @first_ping_ms 25
  @silence_ms 15_000

  defstruct [
    :address,
    :opts,
    :socket,
    :dialer,
    :error,
    :logged_code,
    :received_ms,
    :session,
    wait_ms: @min_wait_ms,
    catalogue: Catalogue.new(),
    channels: %{},
    next_id: 1,
    clock: ClockEstimate.new(),
    pings: 0,
    connections: 0,
    positions: %Positions{},
    bytes: 0
  ]

  # The options are token, tls, now, position (a path or nil), save_every and log.
  @spec start(Address.t(), map(), pid()) :: {:ok, pid()}
  def start(address, opts, owner), do: GenServer.start(__MODULE__, {address, opts, owner})

  @doc "Waits for the catalogue. Returns `{:ok, %{name => type}}`, or the reason that it is not available yet."
  @spec await_catalogue(pid(), non_neg_integer()) ::
          {:ok, %{String.t() => String.t()}} | {:error, Situ.Error.t()}
  def await_catalogue(pid, wait_ms) do
    GenServer.call(pid, {:catalogue, wait_ms}, wait_ms + 30_000)
  end

  @doc "Subscribes the calling process, which then receives `{:situ_link, channel, event}` messages."
  @spec subscribe(pid(), map()) :: {:ok, Frame.channel()} | {:error, Situ.Error.t()}
  def subscribe(pid, request), do: GenServer.call(pid, {:subscribe, request}, 30_000)

  @doc "Reports that the subscriber has consumed `bytes` of its messages, up to the originating time `last`."
  @spec report_consumed(pid(), Frame.channel(), non_neg_integer(), Situ.Time.t() | nil) :: :ok
  def report_consumed(pid, id, bytes, last), do: GenServer.cast(pid, {:consumed, id, bytes, last})

  @doc "Makes the position of a stream its last confirmed message instead of the last one delivered."
  @spec enable_confirmation(pid(), String.t()) :: :ok
  def enable_confirmation(pid, name), do: GenServer.call(pid, {:confirming, name}, 30_000)

  @spec confirm(pid(), String.t(), Situ.Time.t()) :: :ok
  def confirm(pid, name, time), do: GenServer.cast(pid, {:confirm, name, time})

  @spec unsubscribe(pid(), Frame.channel()) :: :ok
  def unsubscribe(pid, id), do: GenServer.cast(pid, {:unsubscribe, id})

  @spec link_info(pid()) :: map()
  def link_info(pid), do: GenServer.call(pid, :info, 30_000)

  @spec close(pid()) :: :ok
  def close(pid) do
    GenServer.stop(pid, :normal, 30_000)
  catch
    :exit, _ -> :ok
  end

  @impl true
  def init({address, opts, owner}) do
    Process.flag(:trap_exit, true)
    Process.monitor(owner)
    {:ok, _} = Registry.register(Situ.Link.Registry, :links, Address.to_string(address))
    Process.send_after(self(), :save, opts.save_every)
    {:ok, %__MODULE__{address: address, opts: opts}, {:continue, :dial}}
  end

  @impl true
  def handle_continue(:dial, state), do: {:noreply, start_dialer(state)}

  defp start_dialer(state), do: %{state | dialer: Dialer.start_dialer(state.address, state.opts)}

  @impl true
  def handle_call({:catalogue, wait_ms}, from, state) do
    if fatal_error?(state.error),
      do: {:reply, {:error, state.error}, state},
      else: {:noreply, %{state | catalogue: Catalogue.add_waiter(state.catalogue, from, wait_ms)}}
  end

  def handle_call({:subscribe, request}, {pid, _}, state) do
    id = state.next_id
    Process.monitor(pid)
    channel = Channel.new(id, pid, request)
    state = %{state | next_id: id + 1, channels: Map.put(state.channels, id, channel)}
    {:reply, {:ok, id}, send_subscribe(state, channel)}
  end

  def handle_call({:confirming, name}, _from, state),
    do: {:reply, :ok, %{state | positions: Positions.enable_confirmation(state.positions, name)}}

  def handle_call(:info, _from, state), do: {:reply, LinkInfo.build_link_info(state), state}

  @impl true
  def handle_cast({:consumed, id, bytes, last}, state) do
    case state.channels do
      %{^id => channel} ->
        channel = Channel.record_consumed(channel, bytes, last, LinkInfo.sender_time(state))
        {:noreply, FrameHandler.send_credit(state, channel)}

      _ ->
        {:noreply, state}
    end
  end

  def handle_cast({:confirm, name, time}, state),
    do: {:noreply, %{state | positions: Positions.confirm(state.positions, name, time)}}

  def handle_cast({:unsubscribe, id}, state), do: {:noreply, remove_channel(state, id)}

  defp remove_channel(state, id) do
    state = FrameHandler.send_frame(state, {:unsubscribe, id})

    case Map.pop(state.channels, id) do
      {nil, _} ->
        state

      {channel, channels} ->
        DatagramReceiver.stop_receiver(channel)
        positions = Positions.retain_position(state.positions, channel.name, channel.consumed)
        %{state | channels: channels, positions: positions}
    end
  end

  @impl true
  def handle_info({:dialed, dialer, {:ok, socket, _welcome}}, %{dialer: dialer} = state) do
    state = %{
      state
      | socket: socket,
        dialer: nil,
        error: nil,
        logged_code: nil,
        wait_ms: @min_wait_ms
    }

    now = System.monotonic_time(:millisecond)

    state = %{
      state
      | session: make_ref(),
        received_ms: now,
        pings: 0,
        connections: state.connections + 1
    }

    case Socket.enable_frames(socket, Dialer.max_bytes()) do
      :ok ->
        send(self(), {:ping, state.session})
        # Subscribe again to the streams of the connection that was lost.
        {:noreply, state.channels |> Map.values() |> Enum.reduce(state, &send_subscribe(&2, &1))}

      {:error, reason} ->
        {:noreply, handle_disconnect(state, Socket.reason_text(reason))}
    end
  end

  def handle_info({:dialed, dialer, {:error, error}}, %{dialer: dialer} = state) do
    {:noreply, schedule_reconnect(%{state | dialer: nil}, error)}
  end

  def handle_info(:dial, %{socket: nil, dialer: nil} = state), do: {:noreply, start_dialer(state)}

  def handle_info({kind, socket, body}, %{socket: {_, socket}} = state)
      when kind in [:tcp, :ssl] do
    state = %{
      state
      | received_ms: System.monotonic_time(:millisecond),
        bytes: state.bytes + byte_size(body)
    }

    with {:ok, frame} <- Frame.decode(body),
         {:ok, state} <- FrameHandler.handle_frame(frame, byte_size(body), state) do
      _ = Socket.activate_once(state.socket)
      {:noreply, state}
    else
      {:error, why} -> {:noreply, handle_disconnect(state, why)}
    end
  end

  def handle_info({kind, socket}, %{socket: {_, socket}} = state)
      when kind in [:tcp_closed, :ssl_closed],
      do: {:noreply, handle_disconnect(state, "the other side closed the connection")}

  def handle_info({kind, socket, reason}, %{socket: {_, socket}} = state)
      when kind in [:tcp_error, :ssl_error],
      do: {:noreply, handle_disconnect(state, Socket.reason_text(reason))}

  def handle_info({:ping, session}, %{session: session, socket: socket} = state)
      when socket != nil do
    if System.monotonic_time(:millisecond) - state.received_ms > @silence_ms do
      {:noreply,
       handle_disconnect(state, "no data was received for #{div(@silence_ms, 1_000)} s")}
    else
      interval = if state.pings < @first_pings, do: @first_ping_ms, else: @ping_ms
      Process.send_after(self(), {:ping, session}, interval)

      {:noreply,
       FrameHandler.send_frame(%{state | pings: state.pings + 1}, {:ping, state.opts.now.()})}
    end
  end

  # Datagrams arrive without credit, so they are dropped when the window is full.
  def handle_info({:situ_datagrams, id, lost, body}, state) when is_map_key(state.channels, id) do
    state = if lost > 0, do: FrameHandler.deliver_event(state, id, {:lost, lost}), else: state

    with {:ok, {:batch, ^id, _, _, count, _} = batch} <- Frame.decode(body),
         {:full, false, _} <- {:full, Channel.full?(state.channels[id]), count},
         {:ok, state} <- FrameHandler.handle_frame(batch, byte_size(body), state) do
      {:noreply, state}
    else
      {:full, true, count} -> {:noreply, FrameHandler.deliver_event(state, id, {:lost, count})}
      _ -> {:noreply, state}
    end
  end

  def handle_info({:waited, from}, state) do
    error = state.error || no_reply_error(state)
    {:noreply, %{state | catalogue: Catalogue.expire_waiter(state.catalogue, from, error)}}
  end

  def handle_info(:save, state) do
    Process.send_after(self(), :save, state.opts.save_every)
    {:noreply, save_positions(state)}
  end

  def handle_info({:DOWN, _, :process, pid, _}, state) do
    case Enum.find(state.channels, fn {_, channel} -> channel.pid == pid end) do
      # A component that restarts subscribes again. If the pipeline ends, this process ends, too.
      {id, _} -> {:noreply, remove_channel(state, id)}
      nil -> {:stop, :normal, state}
    end
  end

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def terminate(_reason, state) do
    save_positions(state)
    if state.socket, do: Socket.close(state.socket)
  end

  # The following functions connect and reconnect.

  defp send_subscribe(%{socket: nil} = state, _channel), do: state
  defp send_subscribe(state, %{ended?: true}), do: state

  defp send_subscribe(state, channel) do
    {map, channel} = channel |> Channel.build_request() |> DatagramReceiver.add_datagram_request()

    state
    |> FrameHandler.put_channel(channel)
    |> FrameHandler.send_frame({:subscribe, channel.id, map})
  end

  defp handle_disconnect(state, why) do
    Socket.close(state.socket)
    address = Address.to_string(state.address)

    schedule_reconnect(
      %{state | socket: nil},
      Situ.Error.new(:link_lost, "the link to #{address} was lost", why: why)
    )
  end

  # An error that repeats is logged only once.
  defp schedule_reconnect(state, error) do
    if state.logged_code != error.code and state.connections > 0,
      do: Logger.warning(Exception.message(error))

    jitter = :rand.uniform(div(state.wait_ms, 4) + 1)
    Process.send_after(self(), :dial, state.wait_ms + jitter)

    state = %{
      state
      | wait_ms: min(state.wait_ms * 2, @max_wait_ms),
        logged_code: error.code,
        error: error
    }

    if fatal_error?(error),
      do: %{state | catalogue: Catalogue.fail_waiters(state.catalogue, error)},
      else: state
  end

  # Waiting longer cannot resolve these errors.
  @fatal ~w(wrong_token wrong_version wrong_certificate no_link bad_address no_recording)a
  defp fatal_error?(error), do: error != nil and error.code in @fatal

  defp no_reply_error(state),
    do: Situ.Error.new(:unreachable, "#{Address.to_string(state.address)} has not responded yet")

  defp save_positions(%{opts: %{position: nil}} = state), do: state

  defp save_positions(state) do
    consumed = for {_, channel} <- state.channels, do: {channel.name, channel.consumed}
    {result, positions} = Positions.save_changes(state.positions, state.opts.position, consumed)
    with {:error, error} <- result, do: Logger.error(Exception.message(error))
    %{state | positions: positions}
  end
end
