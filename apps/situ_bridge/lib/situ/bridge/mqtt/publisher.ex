defmodule Situ.Bridge.Mqtt.Publisher do
  @moduledoc false
  # The connection of a sink. Its outbox keeps messages until the broker has confirmed them, over all connections. With
  # QoS 2, the broker keeps the session between connections, so that no message is published twice.
  use GenServer
  require Logger
  alias Situ.Bridge.Mqtt.{ClientOptions, Outbox, Reason, Wire}
  alias Situ.Bridge.Net.{ClientSocket, Drain, KeepAlive, SendQueue}
  alias Situ.Bridge.PeerSender
  @behaviour PeerSender

  @min_wait_ms 50
  @max_wait_ms 5_000
  @max_packet 65_536
  @max_id 65_535
  # A connection that ends before the broker's first packet may come from a broker that does not know MQTT 5.
  @max_silent 3
  # A broker without `receive_maximum` takes any number of messages.
  @unlimited 65_535
  # In MQTT 3.1.1, a broker cannot announce a limit or refuse a message. Mosquitto silently drops messages with QoS 2 if
  # more than its `max_inflight_messages` (by default 20) are in flight.
  @old_window 20

  defstruct [
    :opts,
    :version,
    :tcp,
    :keep_alive,
    :logged_error,
    up?: false,
    was_up?: false,
    answered?: true,
    silent: 0,
    received_bytes: "",
    wait_ms: @min_wait_ms,
    limits: %{},
    aliases: %{},
    outbox: %Outbox{},
    dropped: 0
  ]

  @type message :: %{
          topic: String.t(),
          payload: iodata(),
          qos: 0..2,
          retain?: boolean(),
          properties: [{atom(), term()}]
        }

  @doc """
  Starts the publisher. `opts` are host, port, tls, version, qos, session_expiry, high_water_mark, and the options of
  `Wire.encode_connect/1`.
  """
  @spec start_link(keyword()) :: {:ok, pid()}
  def start_link(opts) do
    {:ok, _} = GenServer.start_link(__MODULE__, opts)
  end

  @impl PeerSender
  def count_ready(server), do: GenServer.call(server, :ready)

  @impl PeerSender
  def count_dropped(server), do: GenServer.call(server, :dropped)

  @impl PeerSender
  def put(server, message), do: GenServer.call(server, {:put, message}, :infinity)

  @impl PeerSender
  defdelegate close(server, timeout), to: Drain

  @impl true
  def init(opts) do
    Process.flag(:trap_exit, true)
    send(self(), :connect)
    {:ok, %__MODULE__{opts: opts, version: opts[:version] || 5}}
  end

  @impl true
  def handle_call(:ready, _from, state), do: {:reply, if(state.up?, do: 1, else: 0), state}
  def handle_call(:dropped, _from, state), do: {:reply, state.dropped, state}

  # With QoS 0, messages are lost while the broker is unreachable, except before the first connection.
  def handle_call({:put, %{qos: 0} = message}, _from, state) do
    cond do
      state.up? -> {:reply, :ok, send_messages([{0, message, false}], state)}
      state.was_up? -> {:reply, :ok, %{state | dropped: state.dropped + 1}}
      true -> {:reply, :full, state}
    end
  end

  def handle_call({:put, message}, _from, %{opts: opts} = state) do
    case Outbox.add(state.outbox, message, min(opts[:high_water_mark], @max_id)) do
      {:ok, outbox} -> {:reply, :ok, send_waiting(%{state | outbox: outbox})}
      :full -> {:reply, :full, state}
    end
  end

  def handle_call({:drain, deadline}, from, state) do
    Drain.reply_when_drained(from, deadline, Outbox.count(state.outbox))
    {:noreply, state}
  end

  @impl true
  def handle_info(:connect, %{opts: opts} = state) do
    with {:ok, tcp} <-
           ClientSocket.connect(opts[:host], opts[:port], opts[:tls], SendQueue.socket_options()),
         :ok <- ClientSocket.send_bytes(tcp, encode_connect(state)) do
      state = %{state | tcp: tcp, received_bytes: "", answered?: false}
      {:noreply, keep_alive(state, ClientOptions.ping_interval_ms(opts))}
    else
      {:error, reason} -> {:noreply, schedule_reconnect(state, reason)}
    end
  end

  def handle_info({:drain, from, deadline}, state) do
    Drain.reply_when_drained(from, deadline, Outbox.count(state.outbox))
    {:noreply, state}
  end

  # A TLS connection runs in separate processes, whose exits arrive here.
  def handle_info({:EXIT, _pid, :normal}, state), do: {:noreply, state}
  def handle_info({:EXIT, _pid, reason}, state), do: {:stop, reason, state}

  def handle_info(message, state) do
    case ClientSocket.match_message(message, state.tcp) do
      {:ok, bytes} ->
        state = %{state | keep_alive: KeepAlive.note_bytes(state.keep_alive)}
        state = handle_packets(%{state | received_bytes: state.received_bytes <> bytes})
        if state.tcp, do: ClientSocket.activate_once(state.tcp)
        {:noreply, state}

      {:disconnected, reason} ->
        {:noreply, schedule_reconnect(lower_version(state), reason)}

      :other ->
        {:noreply, check_peer(message, state)}
    end
  end

  defp keep_alive(%{keep_alive: %{interval_ms: interval_ms}} = state, interval_ms), do: state

  defp keep_alive(state, interval_ms) do
    KeepAlive.stop(state.keep_alive)
    %{state | keep_alive: KeepAlive.start_link(state.tcp, interval_ms, Wire.encode_ping())}
  end

  defp check_peer(message, state) do
    case KeepAlive.handle_info(message, state.keep_alive) do
      {:ok, keep_alive} -> %{state | keep_alive: keep_alive}
      {:silent, why} -> schedule_reconnect(state, why)
      :other -> state
    end
  end

  # The session begins with this process, so the broker forgets an earlier one at the first connection. MQTT 3.1.1
  # cannot begin and keep a session at once, but the identifier of a new process is random.
  defp encode_connect(%{opts: opts, version: version} = state) do
    clean = opts[:qos] < 2 or (version == 5 and not state.was_up?)
    properties = if opts[:qos] == 2, do: [session_expiry: opts[:session_expiry]], else: []
    Wire.encode_connect([version: version, clean: clean, properties: properties] ++ opts)
  end

  defp handle_packets(%{tcp: nil} = state), do: state

  defp handle_packets(state) do
    case Wire.parse_packet(state.received_bytes, @max_packet, state.version) do
      {:ok, packet, rest} ->
        packet |> handle_packet(%{state | received_bytes: rest}) |> handle_packets()

      :more ->
        state

      {:error, why} ->
        schedule_reconnect(state, why)
    end
  end

  defp handle_packet({:connack, _, code, _}, %{version: 5, was_up?: false, opts: opts} = state)
       when code in [1, 0x84] do
    if opts[:version],
      do: schedule_reconnect(state, "the broker: " <> Reason.describe(0x84)),
      else: schedule_reconnect(%{state | version: 4}, :closed)
  end

  defp handle_packet({:connack, present?, 0, limits}, state) do
    {received, outbox} = Outbox.restart(state.outbox, present? and state.opts[:qos] == 2)
    state = %{state | up?: true, was_up?: true, answered?: true, wait_ms: @min_wait_ms}
    state = %{state | logged_error: nil, limits: limits, aliases: %{}, outbox: outbox}
    state = keep_alive(state, ClientOptions.ping_interval_ms(state.opts, limits))
    warn_of_limits(state)
    releases = Enum.map(received, &Wire.encode_acknowledgement(:pubrel, &1))
    send_waiting(send_packet(releases, state))
  end

  defp handle_packet({:connack, _, code, properties}, state) do
    why = "the broker: " <> Reason.describe(code, properties)
    schedule_reconnect(%{state | answered?: true}, why)
  end

  # Codes from 0x80 refuse a message, which the broker would refuse again.
  defp handle_packet({kind, id, code, properties}, state)
       when kind in [:puback, :pubrec] and code >= 0x80 do
    log_error(state, "the broker refuses a message: " <> Reason.describe(code, properties))
    send_waiting(%{state | outbox: Outbox.confirm(state.outbox, id), dropped: state.dropped + 1})
  end

  defp handle_packet({:pubrec, id, _code, _}, state) do
    state = %{state | outbox: Outbox.receive(state.outbox, id)}
    send_packet(Wire.encode_acknowledgement(:pubrel, id), state)
  end

  defp handle_packet({kind, id, _code, _}, state) when kind in [:puback, :pubcomp],
    do: send_waiting(%{state | outbox: Outbox.confirm(state.outbox, id)})

  defp handle_packet({:disconnect, code, properties}, state),
    do: schedule_reconnect(state, "the broker: " <> Reason.describe(code, properties))

  defp handle_packet(_other, state), do: state

  defp send_waiting(%{up?: false} = state), do: state

  defp send_waiting(state) do
    {messages, outbox} = Outbox.take_waiting(state.outbox, window(state))
    send_messages(messages, %{state | outbox: outbox})
  end

  defp window(%{version: 4, opts: opts}),
    do: if(opts[:qos] == 2, do: @old_window, else: @unlimited)

  defp window(state), do: state.limits[:receive_maximum] || @unlimited

  defp send_messages([], state), do: state

  defp send_messages(messages, state) do
    {packets, state} = Enum.map_reduce(messages, state, &encode_publish/2)
    send_packet(packets, state)
  end

  defp encode_publish({id, message, duplicate?}, state) do
    {topic, alias_properties, aliases} = choose_alias(message.topic, state)

    fields = [
      version: state.version,
      qos: min(message.qos, state.limits[:maximum_qos] || 2),
      id: id,
      retain: message.retain?,
      duplicate: duplicate?,
      properties: alias_properties ++ message.properties
    ]

    {Wire.encode_publish(topic, message.payload, fields), %{state | aliases: aliases}}
  end

  # A topic is sent once for each connection, as far as the broker stores topics.
  defp choose_alias(topic, %{aliases: aliases, limits: limits}) do
    case aliases do
      %{^topic => number} ->
        {"", [topic_alias: number], aliases}

      _ ->
        add_alias(topic, aliases, limits[:topic_alias_maximum] || 0)
    end
  end

  defp add_alias(topic, aliases, max) when map_size(aliases) < max do
    number = map_size(aliases) + 1
    {topic, [topic_alias: number], Map.put(aliases, topic, number)}
  end

  defp add_alias(topic, aliases, _max), do: {topic, [], aliases}

  defp warn_of_limits(%{opts: opts, limits: limits} = state) do
    if opts[:qos] > (limits[:maximum_qos] || 2),
      do: log_error(state, "the broker only supports QoS #{limits[:maximum_qos]}, which is used")
  end

  defp send_packet([], state), do: state

  defp send_packet(bytes, state) do
    case ClientSocket.send_bytes(state.tcp, bytes) do
      :ok -> state
      {:error, reason} -> schedule_reconnect(state, reason)
    end
  end

  defp lower_version(%{answered?: false, was_up?: false} = state) do
    silent = state.silent + 1
    version = if silent >= @max_silent, do: state.opts[:version] || 4, else: state.version
    %{state | silent: silent, version: version}
  end

  defp lower_version(state), do: state

  # A repeated error is logged once, not at every attempt.
  defp schedule_reconnect(state, reason) do
    KeepAlive.stop(state.keep_alive)
    if state.tcp, do: ClientSocket.close(state.tcp)
    if state.logged_error != reason and reason != :closed, do: log_error(state, reason)

    Process.send_after(self(), :connect, state.wait_ms)
    wait_ms = min(state.wait_ms * 2, @max_wait_ms)
    state = %{state | tcp: nil, keep_alive: nil, up?: false}
    %{state | logged_error: reason, wait_ms: wait_ms}
  end

  defp log_error(%{opts: opts}, reason),
    do: Logger.warning("#{opts[:host]}:#{opts[:port]}: #{ClientSocket.describe_reason(reason)}")

  @impl true
  def terminate(_reason, %{tcp: nil}), do: :ok

  def terminate(_reason, %{tcp: tcp} = state) do
    properties = if state.opts[:qos] == 2, do: [session_expiry: 0], else: []
    ClientSocket.send_bytes(tcp, Wire.encode_disconnect(state.version, properties))
    ClientSocket.close(tcp)
  end
end
