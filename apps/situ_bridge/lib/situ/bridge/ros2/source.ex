defmodule Situ.Bridge.Ros2.Source do
  alias Situ.Bridge.Mcap.Codec
  alias Situ.Bridge.Ros2.Zenoh

  # Options shared by sources and sinks.
  @common_options Zenoh.options() ++
                    [
                      ros_type: [
                        type: {:optional, :string},
                        default: nil,
                        doc: "The ROS type, such as \"sensor_msgs/msg/Imu\"."
                      ],
                      definition: [
                        type: {:optional, :string},
                        default: nil,
                        doc: "The definition (`.msg`), unless the type is a standard ROS type."
                      ],
                      depth: [
                        type: {:integer, 1, 1_000_000},
                        default: 1,
                        doc: "Number of messages that `latch:` keeps (ROS's depth)."
                      ]
                    ]
  @schema [
            topic: [type: :string, required: true, doc: "The topic."],
            times: [
              type: {:in, [:header, :sender, :arrival]},
              default: :header,
              doc:
                "Originating times: the stamp in the header (the sending time if there is none), the sending time, " <>
                  "or the arrival time."
            ],
            high_water_mark: [
              type: :pos_integer,
              default: 1_000,
              doc: "Maximum number of messages that are read ahead."
            ],
            latch: [
              type: :boolean,
              default: false,
              doc:
                "Also receives the last messages sent before, if the publisher keeps them (durability TRANSIENT_LOCAL)."
            ],
            type: [type: :any, default: :any, doc: "The type of the stream."]
          ] ++ @common_options ++ Codec.reader_options()
  @moduledoc false
  # Subscribes to a topic. The source never ends.
  use Situ.Component, outputs: [out: :any], options: @schema
  alias Situ.Bridge.PayloadDecoder
  alias Situ.Bridge.Ros.{Definition, Library, StandardTypes, Wire}
  alias Situ.Bridge.Ros2.{Keys, Session, TypeHash}

  def schema, do: @schema
  def common_options, do: @common_options

  @doc "Returns the depth of the session according to `latch:` and `depth:`, or nil."
  def latch_depth(opts), do: if(opts[:latch], do: opts[:depth])

  @impl true
  def init(opts) do
    decoder = PayloadDecoder.new(times: opts[:times], format: :ros)

    {:ok,
     %{
       opts: opts,
       session: nil,
       unread_counter: :atomics.new(1, []),
       decoder: decoder,
       definitions: %{}
     }}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    {definitions, type_opts} = expected_type(opts)

    session_opts = [
      role: :subscriber,
      unread_counter: state.unread_counter,
      node: Zenoh.node_name(opts)
    ]

    session_opts = [depth: latch_depth(opts)] ++ session_opts ++ type_opts

    session_opts =
      session_opts ++ Keyword.take(opts, [:router, :domain, :topic, :high_water_mark])

    session = session_opts |> Session.start_link() |> Situ.Error.unwrap!()
    {[{:complete, :infinity}], %{state | session: session, definitions: definitions}}
  end

  # If the options name a type, only that type is accepted.
  defp expected_type(opts) do
    if opts[:ros_type] do
      type = Definition.strip_kind(opts[:ros_type])

      case find_definition(type, opts[:definition]) do
        {:ok, definition} ->
          {%{type => {:ok, definition}}, [type: type, hash: TypeHash.hash_definition(definition)]}

        {:error, why} ->
          raise Situ.Error.new(:bad_definition, "the definition of #{type} is invalid",
                  why: why,
                  fix: "give its definition with `definition:`"
                )
      end
    else
      {%{}, [type: nil, hash: nil]}
    end
  end

  @doc false
  def find_definition(type, nil) do
    case Library.fetch(type, :ros2) do
      {:ok, text} -> Definition.parse(type, text, :ros2)
      :error -> {:error, "it is not a standard ROS type"}
    end
  end

  def find_definition(type, text), do: Definition.parse(type, text, :ros2)

  @impl true
  def handle_info({:ros2, {key, attachment, payload}}, context, state) do
    :atomics.sub(state.unread_counter, 1, 1)
    {definition, state} = ensure_definition(Keys.parse_type(key), state)

    result =
      decode_payload(payload, definition, Keys.parse_time(attachment), context.now, state.opts)

    {actions, decoder} = PayloadDecoder.take_decoded(state.decoder, [result])
    {actions, %{state | decoder: decoder}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp ensure_definition(:error, state),
    do: {{:error, "the key of the message contains no type"}, state}

  defp ensure_definition({:ok, type}, %{definitions: definitions} = state) do
    case definitions do
      %{^type => definition} ->
        {definition, state}

      _ ->
        definition = find_definition(type, state.opts[:definition])
        # A topic has one type, so a small cache is enough.
        definitions = if map_size(definitions) < 16, do: definitions, else: %{}
        {definition, %{state | definitions: Map.put(definitions, type, definition)}}
    end
  end

  defp decode_payload(_payload, {:error, why}, _sent, _now, _opts), do: {:error, why}

  defp decode_payload(payload, {:ok, definition}, sent, now, opts) do
    with {:ok, message} <- Wire.decode(definition, payload, :cdr) do
      time = choose_time(opts[:times], message, sent)
      {:ok, {time || now, time != nil, convert_value(definition.name, message, opts)}}
    end
  end

  defp choose_time(:header, %{"header" => %{"stamp" => stamp}}, _sent) when stamp > 0, do: stamp
  defp choose_time(:arrival, _message, _sent), do: nil
  defp choose_time(_times, _message, sent), do: sent

  defp convert_value(name, message, opts) do
    if opts[:messages] == :maps,
      do: message,
      else:
        StandardTypes.from_message(name, message, "/" <> String.trim_leading(opts[:topic], "/"))
  end

  @impl true
  def handle_stop(_final_time, _context, state), do: {[], stop_session(state)}

  @impl true
  def terminate(_reason, state), do: stop_session(state)

  defp stop_session(%{session: nil} = state), do: state

  defp stop_session(state) do
    Session.stop(state.session)
    %{state | session: nil}
  end

  @impl true
  def describe(state), do: PayloadDecoder.describe_counts(state.decoder)
end
