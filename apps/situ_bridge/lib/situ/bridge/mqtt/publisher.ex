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

  @first_wait 50
  @longest_wait 5_000
  @most 65_536

  defstruct [
    :opts,
    :tcp,
    :reported_error,
    up?: false,
    was_up?: false,
    received_bytes: "",
    wait: @first_wait,
    id: 0,
    pending_messages: :queue.new(),
    n: 0,
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
  def ready(server), do: GenServer.call(server, :ready)

  @impl PeerSender
  def dropped(server), do: GenServer.call(server, :dropped)

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
      opts[:qos] == 1 and state.n >= min(opts[:high_water_mark], @most - 1) ->
        {:reply, :full, state}

      opts[:qos] == 1 ->
        id = rem(state.id, @most - 1) + 1

        state = %{
          state
          | id: id,
            n: state.n + 1,
            pending_messages: :queue.in({id, payload}, state.pending_messages)
        }

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

  def handle_call({:drain, until}, from, state) do
    Drain.reply_when_drained(from, until, state.n)
    {:noreply, state}
  end

  defp encode_publish({id, payload}, again?, opts) do
    given = [qos: 1, id: id, retain: opts[:retain], again: again?]
    Wire.encode_publish(opts[:topic], payload, given)
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

  def handle_info({:drain, from, until}, state) do
    Drain.reply_when_drained(from, until, state.n)
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

      {:gone, reason} ->
        {:noreply, schedule_reconnect(state, reason)}

      :other ->
        {:noreply, state}
    end
  end

  defp handle_packets(%{tcp: nil} = state), do: state

  defp handle_packets(state) do
    case Wire.parse_packet(state.received_bytes, @most) do
      {:ok, packet, rest} ->
        packet |> handle_packet(%{state | received_bytes: rest}) |> handle_packets()

      :more ->
        state

      {:error, why} ->
        schedule_reconnect(state, why)
    end
  end

  defp handle_packet({:connack, 0}, state) do
    state = %{state | up?: true, was_up?: true, wait: @first_wait, reported_error: nil}
    waiting = :queue.to_list(state.pending_messages)
    send_packet(Enum.map(waiting, &encode_publish(&1, true, state.opts)), state)
  end

  defp handle_packet({:connack, code}, state),
    do: schedule_reconnect(state, "the broker: " <> Wire.describe_refusal(code))

  # A broker nearly always acknowledges messages in order.
  defp handle_packet({:puback, id}, state) do
    case :queue.peek(state.pending_messages) do
      {:value, {^id, _}} ->
        %{state | n: state.n - 1, pending_messages: :queue.drop(state.pending_messages)}

      _ ->
        pending_messages = :queue.filter(fn {other, _} -> other != id end, state.pending_messages)

        %{state | n: :queue.len(pending_messages), pending_messages: pending_messages}
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

    if state.reported_error != reason and reason != :closed,
      do: Logger.warning("#{state.opts[:host]}:#{state.opts[:port]}: #{inspect(reason)}")

    Process.send_after(self(), :connect, state.wait)

    %{
      state
      | tcp: nil,
        up?: false,
        reported_error: reason,
        wait: min(state.wait * 2, @longest_wait)
    }
  end

  @impl true
  def terminate(_reason, %{tcp: nil}), do: :ok

  def terminate(_reason, %{tcp: tcp}) do
    ClientSocket.send_bytes(tcp, Wire.encode_disconnect())
    ClientSocket.close(tcp)
  end
end
