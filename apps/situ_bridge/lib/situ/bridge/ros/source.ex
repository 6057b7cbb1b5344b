defmodule Situ.Bridge.Ros.Source do
  alias Situ.Bridge.Ros.Address

  @schema [
            topic: [type: :string, required: true, doc: "The topic."],
            ros_type: [
              type: {:optional, :string},
              default: nil,
              doc:
                "Its type, such as \"sensor_msgs/Imu\": publishers of another are refused. By default any, by " <>
                  "their own definition."
            ],
            definition: [
              type: {:optional, :string},
              default: nil,
              doc: "The type's definition (`.msg`), when it is none of ROS's own."
            ],
            times: [
              type: {:in, [:header, :arrival]},
              default: :header,
              doc:
                "Originating times: the stamp of a message's header (on arrival where it has none), or on arrival."
            ],
            high_water_mark: [
              type: :pos_integer,
              default: 1_000,
              doc: "The most messages that are taken ahead."
            ],
            most: [
              type: :pos_integer,
              default: 256 * 1024 * 1024,
              doc: "The largest message, bytes; a publisher that sends a larger one is cut off."
            ],
            type: [type: :any, default: :any, doc: "Type of the stream."]
          ] ++ Address.options()
  @moduledoc false
  # A topic as a source that never ends.
  use Situ.Component, outputs: [out: :any], options: @schema
  alias Situ.Bridge.Inlet
  alias Situ.Bridge.Mcap.Channel
  alias Situ.Bridge.Ros.{Definition, Node, Standard, Wire}

  # A stamp may be the last nanosecond of an int64.
  @latest 9_223_372_036_854_775_807

  def schema, do: @schema

  @impl true
  def init(opts) do
    inlet = Inlet.new(times: opts[:times], format: :ros)

    {:ok,
     %{opts: opts, node: nil, untaken: :atomics.new(1, []), inlet: inlet, known: %{}, ours: nil}}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    ours = definition(opts)
    type = if ours, do: ours.name, else: "*"

    link = %{
      md5sum: if(ours, do: Definition.md5(ours), else: "*"),
      untaken: state.untaken,
      high_water_mark: opts[:high_water_mark],
      most: opts[:most]
    }

    case Node.start_link(
           Address.new(opts),
           {:subscriber, Address.whole(opts[:topic]), type, link}
         ) do
      {:ok, node} -> {[{:complete, :infinity}], %{state | node: node, ours: ours}}
      {:error, error} -> raise error
    end
  end

  defp definition(opts) do
    if opts[:ros_type] do
      given = [type: opts[:ros_type], definition: opts[:definition], encoding: :ros1]
      Situ.Error.unwrap!(Channel.new(opts[:topic], given, nil)).definition
    end
  end

  @impl true
  def handle_info({:ros, theirs, payloads}, context, state) do
    :atomics.sub(state.untaken, 1, length(payloads))
    {definition, state} = known(theirs, state)
    read = Enum.map(payloads, &read(&1, definition, state.opts[:times], context.now))
    {actions, inlet} = Inlet.take_read(state.inlet, read)
    {actions, %{state | inlet: inlet}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  # A publisher's definition is parsed once.
  defp known(_theirs, %{ours: ours} = state) when ours != nil, do: {{:ok, ours}, state}

  defp known(theirs, state) do
    key = {theirs["type"], theirs["message_definition"]}

    case state.known do
      %{^key => definition} ->
        {definition, state}

      known ->
        definition =
          Definition.parse(
            theirs["type"] || "unknown/Unknown",
            theirs["message_definition"] || ""
          )

        # Publishers of a topic agree on its type: few are kept.
        known = if map_size(known) < 16, do: known, else: %{}
        {definition, %{state | known: Map.put(known, key, definition)}}
    end
  end

  defp read(_payload, {:error, why}, _times, _now), do: {:error, why}

  defp read(payload, {:ok, definition}, times, now) do
    with {:ok, message} <- Wire.decode(definition, payload, :ros1) do
      time = if times == :header, do: stamp(message)
      {:ok, {time || now, time != nil, Standard.from(definition.name, message)}}
    end
  end

  defp stamp(%{"header" => %{"stamp" => stamp}}) when is_integer(stamp) and stamp in 1..@latest,
    do: stamp

  defp stamp(_message), do: nil

  @impl true
  def handle_stop(_final_time, _context, state), do: {[], close(state)}

  @impl true
  def terminate(_reason, state), do: close(state)

  defp close(%{node: nil} = state), do: state

  defp close(state) do
    Node.stop(state.node)
    %{state | node: nil}
  end

  @impl true
  def describe(state), do: Inlet.describe(state.inlet)
end
