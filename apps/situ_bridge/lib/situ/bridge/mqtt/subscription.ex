defmodule Situ.Bridge.Mqtt.Subscription do
  @moduledoc false
  # A client with a single subscription. It subscribes as soon as the broker accepts the connection, except in a session
  # that has the subscription already. With QoS 2, a message is delivered when it first arrives, and its identifier is
  # kept until the broker releases it, over all connections of a session. Pure.
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Mqtt.{ClientOptions, Message, Reason, Wire}

  # A connection that ends before the broker's first packet may come from a broker that does not know MQTT 5.
  @max_silent 3
  @aliases 16

  defstruct [
    :arg,
    :version,
    ping_interval_ms: 0,
    buffer: "",
    answered?: false,
    progress?: false,
    proven?: false,
    subscribed?: false,
    silent: 0,
    received: MapSet.new(),
    aliases: %{}
  ]

  @type t :: %__MODULE__{}

  @impl true
  def hello(_host, _port, arg), do: connect(%__MODULE__{arg: arg, version: arg[:version] || 5})

  @impl true
  def resume(_host, _port, %{answered?: false, proven?: false} = state) do
    state = %{state | silent: state.silent + 1}
    version = if state.silent >= @max_silent, do: lower_version(state), else: state.version
    connect(%{state | version: version})
  end

  def resume(_host, _port, state), do: connect(state)

  defp lower_version(state), do: state.arg[:version] || 4

  defp connect(state) do
    %{arg: arg, version: version} = state

    # A session without a name begins with this process.
    clean =
      if arg[:session],
        do: false,
        else: not keeps_session?(arg) or (not state.proven? and version == 5)

    properties = [
      session_expiry: if(keeps_session?(arg), do: arg[:session_expiry]),
      receive_maximum: arg[:receive_maximum],
      maximum_packet_size: arg[:most],
      topic_alias_maximum: @aliases
    ]

    options = [version: version, clean: clean, properties: properties] ++ arg

    state = %{state | ping_interval_ms: ClientOptions.ping_interval_ms(arg)}

    {Wire.encode_connect(options),
     %{state | buffer: "", answered?: false, progress?: false, aliases: %{}}}
  end

  @impl true
  def keep_alive(state), do: {state.ping_interval_ms, Wire.encode_ping()}

  defp keeps_session?(arg), do: arg[:session] != nil or arg[:qos] == 2

  @impl true
  def goodbye(%{version: version, arg: arg}) do
    properties = if arg[:session] == nil and arg[:qos] == 2, do: [session_expiry: 0], else: []
    Wire.encode_disconnect(version, properties)
  end

  @impl true
  def progress?(state), do: state.progress?

  @impl true
  def missing_bytes(state), do: Wire.missing_bytes(state.buffer)

  @impl true
  def read(bytes, state, max),
    do: read_packets(%{state | buffer: state.buffer <> bytes}, max, [], [])

  defp read_packets(state, max, payloads, replies) do
    case Wire.parse_packet(state.buffer, max, state.version) do
      {:ok, packet, rest} ->
        packet |> handle_packet(%{state | buffer: rest}) |> read_further(max, payloads, replies)

      :more ->
        {:ok, Enum.reverse(payloads), IO.iodata_to_binary(replies), state}

      {:error, why} ->
        {:error, why}
    end
  end

  defp read_further({:ok, new, reply, state}, max, payloads, replies),
    do: read_packets(state, max, new ++ payloads, [replies, reply])

  defp read_further(refusal, _max, _payloads, _replies), do: refusal

  defp handle_packet({:connack, _, code, _}, %{version: 5, proven?: false, arg: arg} = state)
       when code in [1, 0x84] do
    if arg[:version],
      do: {:error, "the broker: " <> Reason.describe(0x84)},
      else: {:reconnect, :closed, %{state | version: 4}}
  end

  defp handle_packet({:connack, _, code, properties}, state) when code != 0,
    do:
      {:reconnect, "the broker: " <> Reason.describe(code, properties),
       %{state | answered?: true}}

  defp handle_packet({:connack, present?, 0, properties}, state) do
    received = if present?, do: state.received, else: MapSet.new()
    again? = present? and state.proven?
    interval_ms = ClientOptions.ping_interval_ms(state.arg, properties)
    state = %{state | answered?: true, proven?: true, received: received}
    state = %{state | ping_interval_ms: interval_ms}

    cond do
      present? and state.subscribed? ->
        {:ok, [], "", state}

      state.arg[:share] != nil and properties[:shared_subscriptions_available] == 0 ->
        {:error, "the broker: " <> Reason.describe(0x9E)}

      true ->
        {:ok, [], subscribe(state, again?), state}
    end
  end

  defp handle_packet({:suback, codes, properties}, state) do
    case :binary.last(codes) do
      code when code < 0x80 ->
        {:ok, [], "", %{state | subscribed?: true}}

      _code when state.version == 4 ->
        {:error, "the broker refuses the subscription"}

      code ->
        {:error, "the broker refuses the subscription: " <> Reason.describe(code, properties)}
    end
  end

  defp handle_packet({:publish, publication}, state) do
    with {:ok, publication, state} <- resolve_alias(publication, %{state | progress?: true}),
         do: take_publication(publication, state)
  end

  defp handle_packet({:pubrel, id, _code, _}, state) do
    {:ok, [], Wire.encode_acknowledgement(:pubcomp, id),
     %{state | progress?: true, received: MapSet.delete(state.received, id)}}
  end

  defp handle_packet({:disconnect, code, properties}, _state),
    do: {:error, "the broker: " <> Reason.describe(code, properties)}

  defp handle_packet(_other, state), do: {:ok, [], "", state}

  # The broker may have the subscription although its reply was lost. Then retained messages are not wanted twice.
  defp subscribe(%{arg: arg} = state, again?) do
    arg =
      if again? and arg[:retain_handling] == 0,
        do: Keyword.put(arg, :retain_handling, 1),
        else: arg

    filter = if arg[:share], do: "$share/#{arg[:share]}/#{arg[:topic]}", else: arg[:topic]
    names = [:qos, :no_local, :retain_as_published, :retain_handling]
    Wire.encode_subscribe(1, filter, [version: state.version] ++ Keyword.take(arg, names))
  end

  defp resolve_alias(%{properties: %{topic_alias: number}} = publication, state)
       when number in 1..@aliases do
    case {publication.topic, state.aliases} do
      {"", %{^number => topic}} -> {:ok, %{publication | topic: topic}, state}
      {"", _} -> {:error, "a message with an unknown topic alias"}
      {topic, aliases} -> {:ok, publication, %{state | aliases: Map.put(aliases, number, topic)}}
    end
  end

  defp resolve_alias(%{topic: ""}, _state), do: {:error, "a message without a topic"}

  defp resolve_alias(%{properties: %{topic_alias: _}}, _state),
    do: {:error, "a message with an invalid topic alias"}

  defp resolve_alias(publication, state), do: {:ok, publication, state}

  defp take_publication(%{qos: 0} = publication, state),
    do: {:ok, [payload(publication, state)], "", state}

  defp take_publication(%{qos: 1, id: id} = publication, state),
    do: {:ok, [payload(publication, state)], Wire.encode_acknowledgement(:puback, id), state}

  defp take_publication(%{qos: 2, id: id} = publication, state) do
    reply = Wire.encode_acknowledgement(:pubrec, id)

    if MapSet.member?(state.received, id),
      do: {:ok, [], reply, state},
      else:
        {:ok, [payload(publication, state)], reply,
         %{state | received: MapSet.put(state.received, id)}}
  end

  # A payload with its sender's time (if its format has none), and a function that adds the envelope.
  defp payload(publication, state) do
    time = Message.read_time(publication.properties)

    cond do
      state.arg[:envelope] ->
        {publication.payload, time, &Message.from_publication(%{publication | payload: ""}, &1)}

      time != nil ->
        {publication.payload, time, & &1}

      true ->
        publication.payload
    end
  end
end
