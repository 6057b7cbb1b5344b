defmodule Situ.Remote.Connection do
  @moduledoc false
  # Represents a link as one process of a pipeline. It keeps a connection to the server, receives the catalogue, and
  # passes messages to the components of the streams. After a reconnect it resumes each stream at its last position.
  use GenServer
  alias Situ.Remote.Address
  alias Situ.Remote.Link.{ClockEstimate, Dialer, Frame, Handshake, Socket}
  alias Situ.Remote.Connection.{Catalogue, Channel, DatagramReceiver, Positions, LinkInfo}
  require Logger

  @first_wait 50
  @longest_wait 5_000
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
    :told,
    :heard,
    :session,
    wait: @first_wait,
    catalogue: Catalogue.new(),
    channels: %{},
    next: 1,
    clock: ClockEstimate.new(),
    pings: 0,
    connected: 0,
    positions: %Positions{},
    received: 0
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
  def subscribe(pid, wanted), do: GenServer.call(pid, {:subscribe, wanted}, 30_000)

  @doc "Reports that the subscriber has consumed `bytes` of its messages, up to the originating time `last`."
  @spec report_consumed(pid(), Frame.channel(), non_neg_integer(), Situ.Time.t() | nil) :: :ok
  def report_consumed(pid, id, bytes, last), do: GenServer.cast(pid, {:taken, id, bytes, last})

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
    {:ok, _} = Registry.register(Situ.Remote.Links, :links, Address.to_string(address))
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

  def handle_call({:subscribe, wanted}, {pid, _}, state) do
    id = state.next
    Process.monitor(pid)
    channel = Channel.new(id, pid, wanted)
    state = %{state | next: id + 1, channels: Map.put(state.channels, id, channel)}
    {:reply, {:ok, id}, send_subscribe(state, channel)}
  end

  def handle_call({:confirming, name}, _from, state),
    do: {:reply, :ok, %{state | positions: Positions.enable_confirmation(state.positions, name)}}

  def handle_call(:info, _from, state), do: {:reply, LinkInfo.build_link_info(state), state}

  @impl true
  def handle_cast({:taken, id, bytes, last}, state) do
    case state.channels do
      %{^id => channel} ->
        {:noreply, send_credit(state, Channel.record_consumed(channel, bytes, last))}

      _ ->
        {:noreply, state}
    end
  end

  def handle_cast({:confirm, name, time}, state),
    do: {:noreply, %{state | positions: Positions.confirm(state.positions, name, time)}}

  def handle_cast({:unsubscribe, id}, state), do: {:noreply, remove_channel(state, id)}

  defp send_credit(state, channel) do
    case Channel.take_credit(channel) do
      {0, channel} ->
        put_channel(state, channel)

      {bytes, channel} ->
        state |> put_channel(channel) |> send_frame({:credit, channel.id, bytes})
    end
  end

  defp remove_channel(state, id) do
    state = send_frame(state, {:unsubscribe, id})

    case Map.pop(state.channels, id) do
      {nil, _} ->
        state

      {channel, channels} ->
        DatagramReceiver.stop_receiver(channel)
        positions = Positions.retain_position(state.positions, channel.name, channel.taken)
        %{state | channels: channels, positions: positions}
    end
  end

  @impl true
  def handle_info({:dialed, dialer, {:ok, socket, _welcome}}, %{dialer: dialer} = state) do
    state = %{state | socket: socket, dialer: nil, error: nil, told: nil, wait: @first_wait}
    now = System.monotonic_time(:millisecond)
    state = %{state | session: make_ref(), heard: now, pings: 0, connected: state.connected + 1}

    case Socket.enable_frames(socket, Dialer.most_bytes()) do
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
      | heard: System.monotonic_time(:millisecond),
        received: state.received + byte_size(body)
    }

    with {:ok, frame} <- Frame.decode(body),
         {:ok, state} <- handle_frame(frame, byte_size(body), state) do
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
    if System.monotonic_time(:millisecond) - state.heard > @silence_ms do
      {:noreply,
       handle_disconnect(state, "no data was received for #{div(@silence_ms, 1_000)} s")}
    else
      every = if state.pings < @first_pings, do: @first_ping_ms, else: @ping_ms
      Process.send_after(self(), {:ping, session}, every)
      {:noreply, send_frame(%{state | pings: state.pings + 1}, {:ping, state.opts.now.()})}
    end
  end

  # Datagrams arrive without credit, so they are dropped when the window is full.
  def handle_info({:situ_datagrams, id, lost, body}, state) when is_map_key(state.channels, id) do
    state = if lost > 0, do: deliver_event(state, id, {:lost, lost}), else: state

    with {:ok, {:batch, ^id, _, _, count, _} = batch} <- Frame.decode(body),
         {:full, false, _} <- {:full, Channel.full?(state.channels[id]), count},
         {:ok, state} <- handle_frame(batch, byte_size(body), state) do
      {:noreply, state}
    else
      {:full, true, count} -> {:noreply, deliver_event(state, id, {:lost, count})}
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

  # The following clauses handle frames from the server.

  defp handle_frame({:batch, id, _first, last, count, payload}, size, state),
    do: deliver_batch(state, id, size, last, count, payload)

  defp handle_frame({:part, id, last?, bytes}, _size, state) do
    case state.channels do
      %{^id => channel} ->
        case Channel.add_part(channel, last?, bytes) do
          {:more, channel} ->
            {:ok, send_credit(state, channel)}

          {:whole, body, channel} ->
            handle_joined_batch(Frame.decode(body), byte_size(bytes), put_channel(state, channel))

          {:error, why} ->
            {:error, why}
        end

      _ ->
        {:ok, state}
    end
  end

  defp handle_frame({:streams, %{"streams" => streams}}, _size, state) when is_list(streams),
    do: {:ok, %{state | catalogue: Catalogue.merge_streams(state.catalogue, streams)}}

  defp handle_frame({:subscribed, id, %{"after" => time} = map}, _size, state)
       when is_integer(time) do
    case state.channels do
      %{^id => channel} ->
        DatagramReceiver.handle_subscribed(channel, map, state.socket)
        {:ok, put_channel(state, Channel.mark_subscribed(channel, time))}

      _ ->
        {:ok, state}
    end
  end

  defp handle_frame({:closed, id, time}, _size, state),
    do: {:ok, deliver_event(state, id, {:closed, time})}

  defp handle_frame({:lost, id, n}, _size, state), do: {:ok, deliver_event(state, id, {:lost, n})}

  defp handle_frame({:pong, t0, t1, t2}, _size, state) do
    {:ok,
     %{state | clock: ClockEstimate.add_round_trip(state.clock, {t0, t1, t2, state.opts.now.()})}}
  end

  defp handle_frame({:refused, map}, _size, _state),
    do: {:error, map |> Handshake.error_from_map() |> Exception.message()}

  defp handle_frame(frame, _size, _state), do: {:error, "unexpected frame: #{elem(frame, 0)}"}

  defp handle_joined_batch({:ok, {:batch, _, _, _, _, _} = batch}, size, state),
    do: handle_frame(batch, size, state)

  defp handle_joined_batch(_other, _size, _state),
    do: {:error, "the joined parts are not a batch"}

  defp deliver_batch(state, id, size, last, count, payload) do
    case state.channels do
      %{^id => channel} ->
        case Channel.accept_batch(channel, size, last, count) do
          {:ok, channel} ->
            send(
              channel.pid,
              {:situ_link, id, {:batch, size, payload, channel_clock(state, channel)}}
            )

            {:ok, put_channel(state, channel)}

          {:again, channel} ->
            {:ok, send_credit(state, channel)}

          {:error, why} ->
            {:error, why}
        end

      _ ->
        {:ok, state}
    end
  end

  defp channel_clock(_state, %{times: :sender}), do: nil
  defp channel_clock(state, _channel), do: state.clock

  defp deliver_event(state, id, event) do
    case state.channels do
      %{^id => channel} ->
        send(
          channel.pid,
          {:situ_link, id, convert_event_time(event, channel_clock(state, channel))}
        )

        put_channel(state, Channel.apply_event(channel, event))

      _ ->
        state
    end
  end

  defp convert_event_time({:closed, time}, clock) when clock != nil,
    do: {:closed, ClockEstimate.to_local_time(clock, time)}

  defp convert_event_time(event, _clock), do: event

  defp put_channel(state, channel),
    do: %{state | channels: Map.put(state.channels, channel.id, channel)}

  # The following functions connect and reconnect.

  defp send_subscribe(%{socket: nil} = state, _channel), do: state
  defp send_subscribe(state, %{ended: true}), do: state

  defp send_subscribe(state, channel) do
    {map, channel} = channel |> Channel.build_request() |> DatagramReceiver.add_datagram_request()
    state |> put_channel(channel) |> send_frame({:subscribe, channel.id, map})
  end

  # Send errors are ignored here, because the socket then also reports that it was closed.
  defp send_frame(%{socket: nil} = state, _frame), do: state

  defp send_frame(state, frame) do
    _ = Socket.send(state.socket, Frame.encode(frame))
    state
  end

  defp handle_disconnect(state, why) do
    Socket.close(state.socket)
    where = Address.to_string(state.address)

    schedule_reconnect(
      %{state | socket: nil},
      Situ.Error.new(:link_lost, "the link to #{where} was lost", why: why)
    )
  end

  # An error that repeats is logged only once.
  defp schedule_reconnect(state, error) do
    if state.told != error.code and state.connected > 0,
      do: Logger.warning(Exception.message(error))

    jitter = :rand.uniform(div(state.wait, 4) + 1)
    Process.send_after(self(), :dial, state.wait + jitter)
    state = %{state | wait: min(state.wait * 2, @longest_wait), told: error.code, error: error}

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
    taken = for {_, channel} <- state.channels, do: {channel.name, channel.taken}
    {result, positions} = Positions.save_changes(state.positions, state.opts.position, taken)
    with {:error, error} <- result, do: Logger.error(Exception.message(error))
    %{state | positions: positions}
  end
end
