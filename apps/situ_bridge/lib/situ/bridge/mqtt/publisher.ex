defmodule Situ.Bridge.Mqtt.Publisher do
  @moduledoc false
  # The connection of a sink. It keeps messages until the broker has acknowledged them, and resends them after
  # reconnecting.
  use GenServer
  require Logger
  alias Situ.Bridge.Mqtt.Wire
  alias Situ.Bridge.Net.{ClientSocket, Drain, SendQueue}
  alias Situ.Bridge.PeerSender
  @behaviour PeerSender

  @min_wait_ms 50
  @max_wait_ms 5_000
  @max_packet 65_536
  @max_id 65_535

  defstruct [
    :opts,
    :tcp,
    :logged_error,
    up?: false,
    was_up?: false,
    received_bytes: "",
    wait_ms: @min_wait_ms,
    id: 0,
    unconfirmed_messages: :queue.new(),
    count: 0,
    dropped: 0
  ]

  @doc """
  Starts the publisher. `opts` are host, port, tls, topic, qos, retain, high_water_mark, and the options of
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
  def put(server, payload), do: GenServer.call(server, {:put, payload}, :infinity)

  @impl PeerSender
  defdelegate close(server, timeout), to: Drain

  @impl true
  def init(opts) do
    Process.flag(:trap_exit, true)
    send(self(), :connect)
    {:ok, %__MODULE__{opts: opts}}
  end

  @impl true
  def handle_call(:ready, _from, state), do: {:reply, if(state.up?, do: 1, else: 0), state}
  def handle_call(:dropped, _from, state), do: {:reply, state.dropped, state}

  # With QoS 0, messages are lost while the broker is unreachable, except before the first connection.
  def handle_call({:put, payload}, _from, %{opts: opts} = state) do
    cond do
      opts[:qos] == 1 and state.count >= min(opts[:high_water_mark], @max_id) ->
        {:reply, :full, state}

      opts[:qos] == 1 ->
        id = rem(state.id, @max_id) + 1
        queue = :queue.in({id, payload}, state.unconfirmed_messages)
        state = %{state | id: id, count: state.count + 1, unconfirmed_messages: queue}

        {:reply, :ok,
         if(state.up?,
           do: send_packet(encode_publish({id, payload}, false, opts), state),
           else: state
         )}

      state.up? ->
        {:reply, :ok,
         send_packet(Wire.encode_publish(opts[:topic], payload, retain: opts[:retain]), state)}

      state.was_up? ->
        {:reply, :ok, %{state | dropped: state.dropped + 1}}

      true ->
        {:reply, :full, state}
    end
  end

  def handle_call({:drain, deadline}, from, state) do
    Drain.reply_when_drained(from, deadline, state.count)
    {:noreply, state}
  end

  defp encode_publish({id, payload}, duplicate?, opts) do
    fields = [qos: 1, id: id, retain: opts[:retain], duplicate: duplicate?]
    Wire.encode_publish(opts[:topic], payload, fields)
  end

  @impl true
  def handle_info(:connect, %{opts: opts} = state) do
    with {:ok, tcp} <-
           ClientSocket.connect(opts[:host], opts[:port], opts[:tls], SendQueue.socket_options()),
         :ok <- ClientSocket.send_bytes(tcp, Wire.encode_connect(opts)) do
      {:noreply, %{state | tcp: tcp, received_bytes: ""}}
    else
      {:error, reason} -> {:noreply, schedule_reconnect(state, reason)}
    end
  end

  def handle_info({:drain, from, deadline}, state) do
    Drain.reply_when_drained(from, deadline, state.count)
    {:noreply, state}
  end

  # A TLS connection runs in separate processes, whose exits arrive here.
  def handle_info({:EXIT, _pid, :normal}, state), do: {:noreply, state}
  def handle_info({:EXIT, _pid, reason}, state), do: {:stop, reason, state}

  def handle_info(message, state) do
    case ClientSocket.match_message(message, state.tcp) do
      {:ok, bytes} ->
        state = handle_packets(%{state | received_bytes: state.received_bytes <> bytes})
        if state.tcp, do: ClientSocket.activate_once(state.tcp)
        {:noreply, state}

      {:disconnected, reason} ->
        {:noreply, schedule_reconnect(state, reason)}

      :other ->
        {:noreply, state}
    end
  end

  defp handle_packets(%{tcp: nil} = state), do: state

  defp handle_packets(state) do
    case Wire.parse_packet(state.received_bytes, @max_packet) do
      {:ok, packet, rest} ->
        packet |> handle_packet(%{state | received_bytes: rest}) |> handle_packets()

      :more ->
        state

      {:error, why} ->
        schedule_reconnect(state, why)
    end
  end

  defp handle_packet({:connack, 0}, state) do
    state = %{state | up?: true, was_up?: true, wait_ms: @min_wait_ms, logged_error: nil}
    messages = :queue.to_list(state.unconfirmed_messages)
    send_packet(Enum.map(messages, &encode_publish(&1, true, state.opts)), state)
  end

  defp handle_packet({:connack, code}, state),
    do: schedule_reconnect(state, "the broker: " <> Wire.describe_refusal(code))

  # A broker nearly always acknowledges messages in order.
  defp handle_packet({:puback, id}, state) do
    case :queue.peek(state.unconfirmed_messages) do
      {:value, {^id, _}} ->
        %{
          state
          | count: state.count - 1,
            unconfirmed_messages: :queue.drop(state.unconfirmed_messages)
        }

      _ ->
        queue = :queue.filter(fn {queued, _} -> queued != id end, state.unconfirmed_messages)
        %{state | count: :queue.len(queue), unconfirmed_messages: queue}
    end
  end

  defp handle_packet(_other, state), do: state

  defp send_packet(bytes, state) do
    case ClientSocket.send_bytes(state.tcp, bytes) do
      :ok -> state
      {:error, reason} -> schedule_reconnect(state, reason)
    end
  end

  # A repeated error is logged once, not at every attempt.
  defp schedule_reconnect(state, reason) do
    if state.tcp, do: ClientSocket.close(state.tcp)

    if state.logged_error != reason and reason != :closed,
      do: Logger.warning("#{state.opts[:host]}:#{state.opts[:port]}: #{inspect(reason)}")

    Process.send_after(self(), :connect, state.wait_ms)
    wait_ms = min(state.wait_ms * 2, @max_wait_ms)
    %{state | tcp: nil, up?: false, logged_error: reason, wait_ms: wait_ms}
  end

  @impl true
  def terminate(_reason, %{tcp: nil}), do: :ok

  def terminate(_reason, %{tcp: tcp}) do
    ClientSocket.send_bytes(tcp, Wire.encode_disconnect())
    ClientSocket.close(tcp)
  end
end
