defmodule Situ.Bridge.Ros.Source do
  alias Situ.Bridge.Mcap.Codec
  alias Situ.Bridge.Ros.Address

  @schema [
            topic: [type: :string, required: true, doc: "The topic."],
            ros_type: [
              type: {:optional, :string},
              default: nil,
              doc:
                "The ROS type, such as \"sensor_msgs/Imu\"; publishers with another type are refused. Default: any " <>
                  "type, decoded with the publisher's definition."
            ],
            definition: [
              type: {:optional, :string},
              default: nil,
              doc: "The definition (`.msg`), unless the type is a standard ROS type."
            ],
            times: [
              type: {:in, [:header, :arrival]},
              default: :header,
              doc:
                "Originating times: the header's stamp (or else the arrival time), or always the arrival time."
            ],
            sim_time: [
              type: :boolean,
              default: false,
              doc:
                "Gives messages without a stamp the simulated time of the topic /clock instead of their arrival " <>
                  "time. Messages before the first clock message are skipped."
            ],
            high_water_mark: [
              type: :pos_integer,
              default: 1_000,
              doc: "Maximum number of messages that are read ahead."
            ],
            most: [
              type: :pos_integer,
              default: 256 * 1024 * 1024,
              doc:
                "Maximum message size in bytes. A publisher that sends a larger message is disconnected."
            ],
            type: [type: :any, default: :any, doc: "The type of the stream."]
          ] ++ Codec.reader_options() ++ Address.options()
  @moduledoc false
  # Subscribes to a topic. The source never ends.
  use Situ.Component, outputs: [out: :any], options: @schema
  alias Situ.Bridge.PayloadDecoder
  alias Situ.Bridge.Mcap.Channel
  alias Situ.Bridge.Ros.{Definition, Node, StandardTypes, Wire}

  # The maximum of an int64, which is the latest valid stamp.
  @latest 9_223_372_036_854_775_807
  @clock "rosgraph_msgs/Clock"
  @clock_sum "a9c97c1d230cfc112e270351a944ee47"

  def schema, do: @schema

  @impl true
  def init(opts) do
    decoder = PayloadDecoder.new(times: opts[:times], format: :ros)

    {:ok,
     %{
       opts: opts,
       node: nil,
       clock_node: nil,
       clock: nil,
       unread_counter: :atomics.new(1, []),
       clock_unread_counter: :atomics.new(1, []),
       decoder: decoder,
       definitions: %{},
       expected: nil
     }}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    definition = load_definition(opts)
    type = if definition, do: definition.name, else: "*"

    sum = if definition, do: Definition.md5(definition), else: "*"
    node = start_node!(opts, opts[:topic], type, sum, state.unread_counter)

    clock =
      if opts[:sim_time],
        do: start_node!(opts, "/clock", @clock, @clock_sum, state.clock_unread_counter)

    {[{:complete, :infinity}], %{state | node: node, clock_node: clock, expected: definition}}
  end

  defp start_node!(opts, topic, type, sum, unread_counter) do
    link = %{
      md5sum: sum,
      unread_counter: unread_counter,
      high_water_mark: opts[:high_water_mark],
      most: opts[:most]
    }

    opts
    |> Address.new()
    |> Node.start_link({:subscriber, Address.resolve_name(topic), type, link})
    |> Situ.Error.unwrap!()
  end

  defp load_definition(opts) do
    if opts[:ros_type] do
      channel_opts = [type: opts[:ros_type], definition: opts[:definition], encoding: :ros1]
      Situ.Error.unwrap!(Channel.new(opts[:topic], channel_opts, nil)).definition
    end
  end

  # A clock message has 8 bytes: seconds and nanoseconds.
  @impl true
  def handle_info({:ros, %{"type" => @clock}, payloads}, _context, %{clock_node: node} = state)
      when node != nil do
    :atomics.sub(state.clock_unread_counter, 1, length(payloads))

    case List.last(payloads) do
      <<s::little-32, ns::little-32>> -> {[], %{state | clock: s * 1_000_000_000 + ns}}
      _ -> {[], state}
    end
  end

  def handle_info({:ros, peer_fields, payloads}, context, state) do
    :atomics.sub(state.unread_counter, 1, length(payloads))
    {definition, state} = ensure_definition(peer_fields, state)
    now = if state.opts[:sim_time], do: state.clock, else: context.now
    results = Enum.map(payloads, &decode_payload(&1, definition, state.opts, now))
    {actions, decoder} = PayloadDecoder.take_decoded(state.decoder, results)
    {actions, %{state | decoder: decoder}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  # Parses each publisher's definition only once.
  defp ensure_definition(_peer_fields, %{expected: definition} = state) when definition != nil,
    do: {{:ok, definition}, state}

  defp ensure_definition(peer_fields, state) do
    key = {peer_fields["type"], peer_fields["message_definition"]}

    case state.definitions do
      %{^key => definition} ->
        {definition, state}

      definitions ->
        definition =
          Definition.parse(
            peer_fields["type"] || "unknown/Unknown",
            peer_fields["message_definition"] || ""
          )

        # Publishers of a topic agree on its type, so a small cache is enough.
        definitions = if map_size(definitions) < 16, do: definitions, else: %{}
        {definition, %{state | definitions: Map.put(definitions, key, definition)}}
    end
  end

  defp decode_payload(_payload, {:error, why}, _opts, _now), do: {:error, why}

  defp decode_payload(payload, {:ok, definition}, opts, now) do
    with {:ok, message} <- Wire.decode(definition, payload, :ros1) do
      time = if opts[:times] == :header, do: header_stamp(message)
      add_time(time, now, convert_value(definition.name, message, opts))
    end
  end

  defp add_time(nil, nil, _value), do: {:error, "no message on /clock has arrived yet"}
  defp add_time(time, now, value), do: {:ok, {time || now, time != nil, value}}

  defp convert_value(name, message, opts) do
    if opts[:messages] == :maps,
      do: message,
      else: StandardTypes.from_message(name, message, Address.resolve_name(opts[:topic]))
  end

  defp header_stamp(%{"header" => %{"stamp" => stamp}})
       when is_integer(stamp) and stamp in 1..@latest,
       do: stamp

  defp header_stamp(_message), do: nil

  @impl true
  def handle_stop(_final_time, _context, state), do: {[], stop_nodes(state)}

  @impl true
  def terminate(_reason, state), do: stop_nodes(state)

  defp stop_nodes(%{node: nil} = state), do: state

  defp stop_nodes(state) do
    Node.stop(state.node)
    if state.clock_node, do: Node.stop(state.clock_node)
    %{state | node: nil, clock_node: nil}
  end

  @impl true
  def describe(state), do: PayloadDecoder.describe_counts(state.decoder)
end
