defmodule Situ.CLI.Store.Exchange do
  @moduledoc false
  # The verbs of `situ store` that exchange messages with running programs: send and record.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Recording, Verb}
  alias Situ.CLI.Store.{Arguments, Transport}
  alias Situ.{Error, Pipeline, Store}

  @recording [
    kind: :recording,
    doc: "a store's folder, ROOT/NAME for its newest version NAME.NNNN, or an external file"
  ]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "send"],
        aliases: ["play"],
        summary: "replay a recording to other programs: ZeroMQ, MQTT, ROS 1, ROS 2",
        about: """
        Sends all or the selected streams, each as a topic with the stream's name. --topic is the topic of a single
        stream, or the prefix of the topics of several streams. In names that ROS does not allow, invalid characters
        become _. With --loop, the replay repeats until Ctrl-C.
        """,
        arguments: [path: @recording],
        options:
          Arguments.stream_options("this stream, or a pattern ('Room.*'); default: all") ++
            Transport.wire_options() ++
            [
              Option.new(:topic, :string, "the topic, or the prefix of all topics", short: :t),
              Option.new(
                :speed,
                :float,
                "1.0 is the speed of the recording; 0 is as fast as possible",
                value: "X",
                default: 1.0
              ),
              Option.new(:loop, :flag, "start over at the end of the recording, until Ctrl-C"),
              Option.new(:from, :time, "start at this originating time"),
              Option.new(:to, :time, "end at this originating time"),
              Option.new(:start, :span, "start this long after the beginning of the recording"),
              Option.new(:length, :span, "the length of the interval to send"),
              Option.new(
                :subscribers,
                :integer,
                "ZeroMQ, ROS 1: first wait for this many subscribers",
                default: 1
              ),
              Option.new(
                :skip_damage,
                :flag,
                "omit damaged data; without this flag it is an error"
              )
            ],
        examples: [
          "situ store send recordings/lobby -s Lobby.Level -t level --speed 2",
          "situ store send drive.mcap --system ros --loop",
          "situ store send recordings/lobby -x '*.Video' --system mqtt -a broker:1883 -t lobby/"
        ],
        run: &send_recording/2
      },
      %Verb{
        words: ["store", "record"],
        summary: "record topics of other programs into a store: ZeroMQ, MQTT, ROS 1, ROS 2",
        about: """
        Every topic becomes a stream with the topic's name. Recording ends after --length. Ctrl-C ends it immediately;
        the store is then readable but not closed (`situ store repair` closes it).
        """,
        arguments: [
          out: [kind: :new, doc: "ROOT/NAME of the new store; it becomes NAME.NNNN"],
          topic: [kind: :text, many: true, doc: "the topics (MQTT: + and # are allowed)"]
        ],
        options:
          Transport.wire_options() ++
            [
              Option.new(:length, :span, "stop after this time"),
              Option.new(:number, :integer, "stop after this many messages", short: :n)
            ],
        examples: [
          "situ store record recordings/drive /imu /camera/image_raw --system ros --length 1m",
          "situ store record recordings/lab 'lab/+/level' --system mqtt -a broker"
        ],
        run: &record_topics/2
      }
    ]
  end

  defp send_recording(%{path: path}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    Recording.load_formats([path])
    store = Transport.open_recording!(path, opts)
    streams = Enum.filter(Arguments.select_streams!(store, opts), &(&1.count > 0))

    if streams == [],
      do: raise(Error.new(:no_messages, "#{path} has no messages to send"))

    interval = interval_option(store, streams, opts)
    speed = if opts[:speed] == 0.0, do: :max, else: opts[:speed]
    sent = :counters.new(1, [])

    build = fn p ->
      importer =
        Store.importer(p, store,
          loop: opts[:loop] == true,
          skip_damage: opts[:skip_damage] == true
        )

      publish = Transport.stream_publisher(p, opts)

      for info <- streams do
        importer
        |> Store.stream(info.name)
        |> Situ.map(&count_message(&1, sent))
        |> publish.(topic_name(info.name, streams, opts), info)
      end
    end

    case Pipeline.run(build, pipeline: [replay: [speed: speed] ++ interval]) do
      {:ok, _} ->
        names = Enum.map(streams, & &1.name)
        summary = %{streams: names, messages: :counters.get(sent, 1), system: opts[:system]}

        if opts[:json],
          do: Output.print_json(Map.put(summary, :address, Transport.resolve_address(opts)))

        0

      {:error, error} ->
        raise error
    end
  end

  defp count_message(data, counter) do
    :counters.add(counter, 1, 1)
    data
  end

  defp topic_name(_name, [_], %{topic: topic}) when topic != nil, do: topic

  defp topic_name(name, streams, opts) when is_list(opts),
    do: topic_name(name, streams, Map.new(opts))

  defp topic_name(name, _streams, opts), do: (opts[:topic] || "") <> name

  # Returns the pipeline's option for the interval of the recording that is played.
  defp interval_option(store, streams, opts) do
    {first, last} = Store.interval(streams) || Store.interval(store)
    from = opts[:from] || (opts[:start] && first + opts[:start])
    to = opts[:to] || (opts[:length] && (from || first) + opts[:length])

    cond do
      to != nil and opts[:loop] == true ->
        throw({:usage, "--loop always plays to the end: crop the recording first"})

      from == nil and to == nil ->
        []

      (from || first) > (to || last) ->
        throw({:usage, "no messages between the given times"})

      true ->
        [interval: {from || first, to || :unbounded}]
    end
  end

  defp record_topics(%{out: out, topic: topics}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    me = self()
    counter = :counters.new(1, [])
    most = opts[:number] || :infinity

    build = fn p ->
      store = Store.create(p, Path.basename(out), Path.dirname(out))

      for topic <- Enum.uniq(topics) do
        p
        |> Transport.subscribe_topic(topic, opts)
        |> Situ.map(fn data ->
          :counters.add(counter, 1, 1)
          if :counters.get(counter, 1) >= most, do: send(me, :enough)
          data
        end)
        |> Store.write(store, topic)
      end

      %{path: store.path}
    end

    with {:ok, p} <- Pipeline.start(build, []),
         {:ok, report} <- await_end(p, opts[:length]) do
      path = report.result.path
      summary = %{path: path, messages: :counters.get(counter, 1), streams: Enum.uniq(topics)}
      if opts[:json], do: Output.print_json(summary), else: Output.puts(path)
      0
    else
      {:error, error} -> raise error
    end
  end

  defp await_end(p, length) do
    monitor = Process.monitor(p)

    receive do
      :enough -> Pipeline.stop(p)
      {:DOWN, ^monitor, _, _, _} -> Pipeline.await(p)
    after
      if(length, do: div(length, 1_000_000), else: :infinity) -> Pipeline.stop(p)
    end
  end
end
