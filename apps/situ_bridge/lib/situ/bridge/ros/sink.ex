defmodule Situ.Bridge.Ros.Sink do
  alias Situ.Bridge.PeerSender
  alias Situ.Bridge.Ros.Address

  @schema [
            topic: [type: :string, required: true, doc: "The topic."],
            ros_type: [
              type: {:optional, :string},
              default: nil,
              doc:
                "The ROS type, such as \"sensor_msgs/Imu\". Default: the standard type that fits the first message."
            ],
            definition: [
              type: {:optional, :string},
              default: nil,
              doc: "The definition (`.msg`), unless the type is a standard ROS type."
            ],
            frame: [
              type: :string,
              default: "",
              doc: "The frame of reference in message headers."
            ],
            latch: [
              type: :boolean,
              default: false,
              doc: "Sends the last message to new subscribers."
            ]
          ] ++ Keyword.drop(PeerSender.options(), [:format, :listening]) ++ Address.options()
  @moduledoc false
  # Publishes a stream as a topic as soon as its type is known from the options or from the first message.
  use Situ.Component, inputs: [in: :any], options: @schema
  alias Situ.Bridge.Mcap.Channel
  alias Situ.Bridge.Net.Server
  alias Situ.Bridge.Ros.{Definition, Node, TcpRos}

  def schema, do: @schema

  @impl true
  def init(opts), do: {:ok, %{opts: opts, node: nil, channel: nil, sender: PeerSender.new(opts)}}

  @impl true
  def handle_start(_context, state) do
    if state.opts[:ros_type], do: {[], open_topic(state, nil)}, else: {[], state}
  end

  defp open_topic(%{opts: opts} = state, first) do
    address = Address.new(opts)
    topic = Address.resolve_name(opts[:topic])

    channel_opts = [
      type: opts[:ros_type],
      definition: opts[:definition],
      encoding: :ros1,
      frame: opts[:frame]
    ]

    with {:ok, channel} <- Channel.new(topic, channel_opts, first),
         arg = header_fields(channel, address, topic, opts),
         {:ok, server} <-
           Server.open(
             Address.listen_interface(address),
             0,
             opts[:high_water_mark],
             {TcpRos, arg},
             latch: opts[:latch]
           ),
         role = {:publisher, topic, arg["type"], Server.port(server)},
         {:ok, node} <- Node.start_link(address, role) do
      %{
        state
        | channel: channel,
          node: node,
          sender: PeerSender.attach_server(state.sender, Server, server, nil)
      }
    else
      {:error, error} -> raise error
    end
  end

  defp header_fields(channel, address, topic, opts) do
    {type, _, text} = channel.schema

    %{
      "callerid" => address.node,
      "topic" => topic,
      "type" => type,
      "md5sum" => Definition.md5(channel.definition),
      "message_definition" => text,
      "latching" => if(opts[:latch], do: "1", else: "0")
    }
  end

  @impl true
  def handle_message(:in, message, context, %{channel: nil} = state),
    do: handle_message(:in, message, context, open_topic(state, message.data))

  def handle_message(:in, message, _context, state) do
    bytes =
      Situ.Error.unwrap!(Channel.encode(state.channel, message.data, message.originating_time))

    state.sender |> PeerSender.send_payload(bytes) |> put_sender(state)
  end

  @impl true
  def handle_info(message, _context, state),
    do: state.sender |> PeerSender.handle_stage_message(message) |> put_sender(state)

  defp put_sender({actions, sender}, state), do: {actions, %{state | sender: sender}}

  @impl true
  def handle_closed(:in, _time, _context, %{node: nil} = state), do: {[], state}

  def handle_closed(:in, _time, _context, state) do
    sender = PeerSender.close(state.sender)
    Node.stop(state.node)
    {[], %{state | sender: sender, node: nil}}
  end

  @impl true
  def terminate(_reason, state) do
    if state.node, do: Node.stop(state.node)
    PeerSender.close_now(state.sender)
  end

  @impl true
  def describe(state), do: PeerSender.describe_peers(state.sender)
end
