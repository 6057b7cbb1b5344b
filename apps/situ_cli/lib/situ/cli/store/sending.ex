defmodule Situ.CLI.Store.Sending do
  @moduledoc "The verbs of `situ store` that speak with running programs: send and record."
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Recording, Verb}
  alias Situ.CLI.Store.{Arguments, Wire}
  alias Situ.{Error, Pipeline, Store}

  @recording [
    kind: :recording,
    doc: "a store's folder, ROOT/NAME for the newest NAME.NNNN, or a foreign file"
  ]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "send"],
        aliases: ["play"],
        summary: "replay a recording to other programs: ZeroMQ, MQTT, ROS 1, ROS 2",
        about: """
        All streams, or those chosen, each as a topic of the stream's name; of one stream --topic is the topic, of
        several it stands before their names. Names that ROS does not allow get _ where it wants letters and digits.
        With --loop it goes on until Ctrl-C.
        """,
        arguments: [path: @recording],
        options:
          Arguments.streams("this stream, or a pattern ('Room.*'); default: all") ++
            Wire.options() ++
            [
              Option.new(:topic, :string, "the topic, or what all topics begin with", short: :t),
              Option.new(
                :speed,
                :float,
                "1.0 is the speed of the recording; 0 as fast as possible",
                value: "X",
                default: 1.0
              ),
              Option.new(:loop, :flag, "start over at the recording's end, until Ctrl-C"),
              Option.new(:from, :time, "from this originating time on"),
              Option.new(:to, :time, "up to this originating time"),
              Option.new(:start, :span, "from so long behind the recording's beginning on"),
              Option.new(:length, :span, "no more than so long"),
              Option.new(:subscribers, :integer, "ZeroMQ, ROS 1: wait for so many of them first",
                default: 1
              ),
              Option.new(:skip_damage, :flag, "leave out what is damaged; else that is an error")
            ],
        examples: [
          "situ store send recordings/lobby -s Lobby.Level -t level --speed 2",
          "situ store send drive.mcap --system ros --loop",
          "situ store send recordings/lobby -x '*.Video' --system mqtt -a broker:1883 -t lobby/"
        ],
        run: &send_out/2
      },
      %Verb{
        words: ["store", "record"],
        summary: "record topics of other programs into a store: ZeroMQ, MQTT, ROS 1, ROS 2",
        about: """
        Every topic becomes a stream of its name. It ends after --length; Ctrl-C ends it at once, and the store opens as
        one that was not closed (`situ store repair` closes it).
        """,
        arguments: [
          out: [kind: :new, doc: "ROOT/NAME of the new store; it becomes NAME.NNNN"],
          topic: [kind: :text, many: true, doc: "the topics (MQTT: + and # may stand in them)"]
        ],
        options:
          Wire.options() ++
            [
              Option.new(:length, :span, "stop after so long"),
              Option.new(:number, :integer, "stop after so many messages", short: :n)
            ],
        examples: [
          "situ store record recordings/drive /imu /camera/image_raw --system ros --length 1m",
          "situ store record recordings/lab 'lab/+/level' --system mqtt -a broker"
        ],
        run: &record/2
      }
    ]
  end

  defp send_out(%{path: path}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    Recording.ready([path])
    store = Wire.open!(path, opts)
    streams = Enum.filter(Arguments.chosen!(store, opts), &(&1.count > 0))

    if streams == [],
      do: raise(Error.new(:no_messages, "#{path} has no messages to send"))

    interval = interval(store, streams, opts)
    speed = if opts[:speed] == 0.0, do: :max, else: opts[:speed]
    sent = :counters.new(1, [])

    build = fn p ->
      importer =
        Store.importer(p, store,
          loop: opts[:loop] == true,
          skip_damage: opts[:skip_damage] == true
        )

      publish = Wire.sender(p, opts)

      for info <- streams do
        importer
        |> Store.stream(info.name)
        |> Situ.map(&counted(&1, sent))
        |> publish.(topic(info.name, streams, opts), info)
      end
    end

    case Pipeline.run(build, pipeline: [replay: [speed: speed] ++ interval]) do
      {:ok, _} ->
        names = Enum.map(streams, & &1.name)
        told = %{streams: names, messages: :counters.get(sent, 1), system: opts[:system]}
        if opts[:json], do: Output.json(Map.put(told, :address, Wire.address(opts)))
        0

      {:error, error} ->
        raise error
    end
  end

  defp counted(data, counter) do
    :counters.add(counter, 1, 1)
    data
  end

  defp topic(_name, [_], %{topic: topic}) when topic != nil, do: topic
  defp topic(name, streams, opts) when is_list(opts), do: topic(name, streams, Map.new(opts))
  defp topic(name, _streams, opts), do: (opts[:topic] || "") <> name

  # The part of the recording that is played, as the pipeline's option.
  defp interval(store, streams, opts) do
    {first, last} = Store.interval(streams) || Store.interval(store)
    from = opts[:from] || (opts[:start] && first + opts[:start])
    to = opts[:to] || (opts[:length] && (from || first) + opts[:length])

    cond do
      to != nil and opts[:loop] == true ->
        throw({:usage, "--loop plays to the end: crop it first"})

      from == nil and to == nil ->
        []

      (from || first) > (to || last) ->
        throw({:usage, "nothing lies between the times given"})

      true ->
        [interval: {from || first, to || :unbounded}]
    end
  end

  defp record(%{out: out, topic: topics}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    me = self()
    came = :counters.new(1, [])
    most = opts[:number] || :infinity

    build = fn p ->
      store = Store.create(p, Path.basename(out), Path.dirname(out))

      for topic <- Enum.uniq(topics) do
        p
        |> Wire.receiver(topic, opts)
        |> Situ.map(fn data ->
          :counters.add(came, 1, 1)
          if :counters.get(came, 1) >= most, do: send(me, :enough)
          data
        end)
        |> Store.write(store, topic)
      end

      %{path: store.path}
    end

    with {:ok, p} <- Pipeline.start(build, []),
         {:ok, report} <- ended(p, opts[:length]) do
      path = report.result.path
      told = %{path: path, messages: :counters.get(came, 1), streams: Enum.uniq(topics)}
      if opts[:json], do: Output.json(told), else: Output.puts(path)
      0
    else
      {:error, error} -> raise error
    end
  end

  defp ended(p, length) do
    monitor = Process.monitor(p)

    receive do
      :enough -> Pipeline.stop(p)
      {:DOWN, ^monitor, _, _, _} -> Pipeline.await(p)
    after
      if(length, do: div(length, 1_000_000), else: :infinity) -> Pipeline.stop(p)
    end
  end
end
