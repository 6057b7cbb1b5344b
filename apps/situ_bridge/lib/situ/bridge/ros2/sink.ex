defmodule Situ.Bridge.Ros2.Sink do
  alias Situ.Bridge.PeerSender
  alias Situ.Bridge.Ros2.Source

  @schema [
            topic: [type: :string, required: true, doc: "The topic."],
            frame: [type: :string, default: "", doc: "The frame of reference in message headers."],
            latch: [
              type: :boolean,
              default: false,
              doc:
                "Sends the last messages to new subscribers (durability TRANSIENT_LOCAL), until the stream ends. " <>
                  "See `depth:` for their number."
            ]
          ] ++
            Source.common_options() ++
            Keyword.drop(PeerSender.options(), [:format, :listening, :wait_for])
  @moduledoc false
  # Publishes a stream as a topic as soon as its type is known from the options or from the first message.
  use Situ.Component, inputs: [in: :any], options: @schema
  alias Situ.Bridge.Mcap.Channel
  alias Situ.Bridge.Ros2.{Session, TypeHash, Zenoh}

  def schema, do: @schema

  @impl true
  def init(opts),
    do: {:ok, %{opts: opts, channel: nil, sender: PeerSender.new([wait_for: 0] ++ opts)}}

  @impl true
  def handle_start(_context, state) do
    if state.opts[:ros_type], do: {[], open_topic(state, nil)}, else: {[], state}
  end

  defp open_topic(%{opts: opts} = state, first_value) do
    channel_opts = [
      type: opts[:ros_type],
      definition: opts[:definition],
      frame: opts[:frame],
      encoding: :cdr
    ]

    channel = opts[:topic] |> Channel.new(channel_opts, first_value) |> Situ.Error.unwrap!()
    definition = channel.definition

    session_opts = [
      role: :publisher,
      node: Zenoh.node_name(opts),
      depth: Source.latch_depth(opts),
      type: definition.name,
      hash: TypeHash.hash_definition(definition)
    ]

    session =
      (session_opts ++ Keyword.take(opts, [:router, :domain, :topic, :high_water_mark]))
      |> Session.start_link()

    session = Situ.Error.unwrap!(session)

    %{
      state
      | channel: channel,
        sender: PeerSender.attach_server(state.sender, Session, session, nil)
    }
  end

  @impl true
  def handle_message(:in, message, context, %{channel: nil} = state),
    do: handle_message(:in, message, context, open_topic(state, message.data))

  def handle_message(:in, message, _context, state) do
    time = message.originating_time
    bytes = Situ.Error.unwrap!(Channel.encode(state.channel, message.data, time))
    state.sender |> PeerSender.send_payload({time, bytes}) |> put_sender(state)
  end

  @impl true
  def handle_info(message, _context, state),
    do: state.sender |> PeerSender.handle_stage_message(message) |> put_sender(state)

  defp put_sender({actions, sender}, state), do: {actions, %{state | sender: sender}}

  @impl true
  def handle_closed(:in, _time, _context, %{channel: nil} = state), do: {[], state}

  def handle_closed(:in, _time, _context, state),
    do: {[], %{state | sender: PeerSender.close(state.sender)}}

  @impl true
  def terminate(_reason, state), do: PeerSender.close_now(state.sender)

  @impl true
  def describe(state), do: PeerSender.describe_peers(state.sender)
end
