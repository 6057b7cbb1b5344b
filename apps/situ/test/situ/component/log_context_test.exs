defmodule Situ.Component.LogContextTest do
  use ExUnit.Case, async: false
  require Logger

  defmodule Shout do
    use Situ.Component, inputs: [in: :integer], outputs: [out: :integer]

    @impl true
    def init(_opts), do: {:ok, nil}

    @impl true
    def handle_message(:in, %{data: n} = message, context, state) do
      Logger.info("single #{n}", own: n)
      {[{:out, message.originating_time, n}, {:timer, n, context.now + 1}], state}
    end

    @impl true
    def handle_info({:timer, n}, _context, state) do
      Logger.info("timer #{n}")
      {[], state}
    end

    @impl true
    def terminate(_reason, _state), do: Logger.info("the end")
  end

  defmodule Batches do
    use Situ.Component, inputs: [in: :integer], outputs: [out: :integer]

    @impl true
    def init(_opts), do: {:ok, nil}

    @impl true
    def handle_message(:in, message, context, state),
      do: handle_messages(:in, [message], context, state)

    @impl true
    def handle_messages(:in, messages, _context, state) do
      Logger.info("batch #{length(messages)}", last: List.last(messages).originating_time)
      {[{:out, messages}], state}
    end
  end

  defmodule Report do
    # A handler of the logger that sends the metadata of each line to the test.
    def log(%{meta: meta, msg: {:string, text}}, %{config: %{to: pid}}),
      do: send(pid, {:line, IO.chardata_to_string(text), meta})

    def log(_event, _config), do: :ok
  end

  setup do
    level = Logger.level()
    Logger.configure(level: :info)
    :ok = :logger.add_handler(:situ_report, Report, %{config: %{to: self()}})

    on_exit(fn ->
      :logger.remove_handler(:situ_report)
      Logger.configure(level: level)
    end)
  end

  @moduletag :capture_log

  defp run(build) do
    spec = fn p -> p |> Situ.from_enumerable(for(i <- 1..100, do: {i * 10, i})) |> build.() end
    {:ok, _} = Situ.Pipeline.run(spec, pipeline: [name: "Logs", replay: [speed: :max]])
    collect([])
  end

  defp collect(lines) do
    receive do
      {:line, text, meta} -> collect([{text, meta} | lines])
    after
      0 -> Enum.reverse(lines)
    end
  end

  test "a component's lines have its name and the time of the message" do
    lines = run(&Situ.via(&1, Shout, name: "Shouter"))

    for {text, meta} <- lines,
        do: assert({text, meta.pipeline, meta.component} == {text, "Logs", "Shouter"})

    singles = for {"single " <> _, meta} <- lines, do: {meta.own * 10, meta.originating_time}
    assert length(singles) == 100
    assert Enum.all?(singles, fn {expected, time} -> expected == time end)
    # Timers and the end belong to no message.
    others = for {text, meta} <- lines, text =~ "timer" or text =~ "end", do: meta
    assert length(others) > 1
    refute Enum.any?(others, &is_map_key(&1, :originating_time))
  end

  test "the lines of operators are between two times at most four messages apart" do
    for build <- [
          &Situ.each(&1, fn n -> Logger.info("each", own: n) end, name: "Tell", async: true),
          &Situ.each(&1, fn n, _m -> Logger.info("each", own: n) end, name: "Tell", async: true),
          fn stream ->
            stream
            |> Situ.scan(0, fn n, _ -> n end)
            |> Situ.each(fn n -> Logger.info("each", own: n) end, name: "Tell")
          end
        ] do
      lines = run(build)
      assert length(lines) == 100

      for {"each", %{own: n} = meta} <- lines do
        last = Map.get(meta, :last_originating_time, meta.originating_time)
        assert (n * 10) in meta.originating_time..last
        assert last - meta.originating_time <= 30
        assert meta.pipeline == "Logs"
      end
    end
  end

  test "a line about several messages has the first and the last time" do
    for {"batch " <> count, meta} <- run(&Situ.via(&1, Batches)) do
      first = meta.last - (String.to_integer(count) - 1) * 10
      assert meta.originating_time == first
      assert Map.get(meta, :last_originating_time, first) == meta.last
    end
  end

  test "the jobs of map_async have the time of their message" do
    lines = run(&Situ.map_async(&1, fn n -> Logger.info("job", own: n) end, name: "Ask"))
    assert length(lines) == 100

    for {"job", meta} <- lines do
      assert {meta.pipeline, meta.component} == {"Logs", "Ask"}
      assert meta.originating_time == meta.own * 10
    end
  end

  test "light components that share a process have their own names" do
    lines =
      run(fn stream ->
        stream |> Situ.via(Shout, name: "First") |> Situ.via(Shout, name: "Second")
      end)

    for name <- ["First", "Second"] do
      assert 100 ==
               Enum.count(lines, fn {text, meta} ->
                 text =~ "single" and meta.component == name
               end)
    end
  end

  test "metadata of the call itself remains" do
    own = fn n -> Logger.info("each", component: "Mine", originating_time: n) end

    for {"each", meta} <- run(&Situ.each(&1, own)),
        do: assert(meta.component == "Mine" and meta.originating_time in 1..100)
  end

  test "JSON lines have the time as text" do
    metadata = [
      time: 1_700_000_000_123_456,
      component: "Lips",
      originating_time: 1_700_000_000_000_000_001
    ]

    line = Situ.JsonLog.format(:info, "x", {{2023, 11, 14}, {22, 13, 20, 123}}, metadata)
    assert IO.iodata_to_binary(line) =~ ~s("originating_time":"2023-11-14T22:13:20.000000001Z")
  end

  test "a process that waits keeps no data of its last batch" do
    test = self()

    {:ok, p} =
      Situ.Pipeline.start(fn p ->
        p
        |> Situ.from_enumerable(1..50, every: 1, keep_open: true)
        |> Situ.map(& &1, async: true)
        |> Situ.via(Batches)
        |> Situ.each(&if(&1 == 50, do: send(test, {:last, self()})), async: true)
      end)

    assert_receive {:last, _pid}
    {:links, links} = Process.info(p, :links)

    for pid <- links,
        is_pid(pid),
        {:dictionary, dictionary} <- [Process.info(pid, :dictionary)] do
      refute List.keymember?(dictionary, :situ_left, 0)

      with {:situ_handling, {_, handled}} <- List.keyfind(dictionary, :situ_handling, 0),
           do: assert(handled == nil or is_integer(handled))
    end

    {:ok, _} = Situ.Pipeline.stop(p)
  end
end
