defmodule Situ.Lifecycle.LateTest do
  # A pipeline ends at the last time of its last source. Output that has run ahead of that time is discarded, but
  # later messages derived from messages up to that time are part of the result.
  use ExUnit.Case, async: true

  defmodule Echo do
    # Emits every message twice, the second time 5 ns later.
    use Situ.Component, inputs: [in: :any], outputs: [out: :any]

    @impl true
    def handle_message(:in, %{originating_time: time, data: data}, _context, state),
      do: {[{:out, time, data}, {:out, time + 5, data}], state}
  end

  defmodule Loop do
    use Situ.Component, inputs: [in: :any, back: :any], outputs: [out: :any]

    @impl true
    def init(_opts), do: {:ok, -1}

    @impl true
    def handle_message(_input, message, _context, last) do
      time = max(message.originating_time, last) + 1
      {[{:out, time, message.data}], time}
    end
  end

  defp replay(build),
    do:
      Situ.to_list(build,
        times: true,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

  defp words(stream) do
    Situ.process(stream, nil, fn message, state ->
      words = String.split(message.data)
      {Enum.with_index(words, &{message.originating_time + &2, &1}), state}
    end)
  end

  test "process keeps everything derived from the last message" do
    sentences = [{0, "a b"}, {10, "c d e"}]
    expected = [{0, "a"}, {1, "b"}, {10, "c"}, {11, "d"}, {12, "e"}]
    assert replay(fn p -> p |> Situ.from_enumerable(sentences) |> words() end) == expected

    assert replay(fn p ->
             p
             |> Situ.from_enumerable(sentences)
             |> words()
             |> Situ.map(& &1)
             |> Situ.map(& &1, async: true)
             |> Situ.filter(fn _ -> true end, policy: Situ.Delivery.max_queue(100))
           end) == expected
  end

  test "merge loses nothing at any speed" do
    build = fn p ->
      Situ.merge([
        Situ.from_enumerable(p, 0..2, every: 10),
        Situ.from_enumerable(p, 100..102, every: 15)
      ])
      |> Situ.map(& &1.data)
    end

    for opts <- [[], [replay: [speed: :max]], [replay: [interval: {0, 1_000}, speed: 1.0]]] do
      assert build |> Situ.to_list(pipeline: opts) |> Enum.sort() == [0, 1, 2, 100, 101, 102]
    end

    assert {:ok, merged} =
             Situ.Test.run([a: [{0, 1}, {5, 2}], b: [{0, 3}]], &Situ.merge([&1.a, &1.b]))

    assert merged |> Enum.map(fn {_, message} -> message.data end) |> Enum.sort() == [1, 2, 3]
  end

  test "reorder emits messages at their own times" do
    items = [{0, {30, :a}}, {1, {20, :b}}, {2, {50, :c}}]

    assert replay(fn p ->
             p
             |> Situ.from_enumerable(items)
             |> Situ.reorder(100, time: fn message -> elem(message.data, 0) end)
           end) == [{20, {20, :b}}, {30, {30, :a}}, {50, {50, :c}}]
  end

  test "output that ran ahead of the end is discarded" do
    ticks = fn p -> Situ.repeat(p, :tick, every: 1) end
    echo = fn p -> p |> Situ.from_enumerable(0..1, every: 10) |> Situ.via(Echo) end

    assert replay(fn p ->
             ticks.(p) |> Situ.join(echo.(p), Situ.Reproducible.exact()) |> Situ.map(&elem(&1, 1))
           end) == [{0, 0}, {5, 0}, {10, 1}]
  end

  # The pipeline process is suspended while the last messages are created, so streams that run ahead have plenty of
  # time.
  test "output that ran ahead is discarded even if the pipeline learns of the end late" do
    test = self()

    items =
      Stream.map(0..1, fn item ->
        send(test, {:item, item, self()})
        receive do: (:go -> item)
      end)

    build = fn p ->
      echo = p |> Situ.from_enumerable(items, every: 10) |> Situ.via(Echo)

      p
      |> Situ.repeat(:tick, every: 1)
      |> Situ.join(echo, Situ.Reproducible.exact())
      |> Situ.each(fn _tick, message -> send(test, {:out, message.originating_time}) end)
    end

    {:ok, p} =
      Situ.Pipeline.start_link(build,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    assert_receive {:item, 0, source}
    send(source, :go)
    assert_receive {:item, 1, ^source}
    :sys.suspend(p)
    send(source, :go)
    refute_receive {:out, 15}, 50
    :sys.resume(p)
    assert {:ok, _report} = Situ.Pipeline.await(p)
    assert_received {:out, 10}
    refute_received {:out, 15}
  end

  test "late messages of a component count, and so do the messages derived from them" do
    assert replay(fn p ->
             p
             |> Situ.from_enumerable(0..1, every: 10)
             |> Situ.via(Echo)
             |> Situ.window(-1..0, &Enum.sum/1)
           end) == [{5, 0}, {10, 1}, {15, 2}]

    assert replay(fn p ->
             p |> Situ.from_enumerable(0..1, every: 10) |> Situ.via(Echo) |> Situ.last(2)
           end) == [{10, 1}, {15, 1}]
  end

  test "a cycle with ever later messages ends with the pipeline" do
    {:ok, report} =
      Situ.Pipeline.run(
        fn p ->
          echo = Situ.Pipeline.add(p, Loop, name: "Loop")
          Situ.Pipeline.connect(Situ.from_enumerable(p, 0..2, every: 10), echo, :in)
          Situ.Pipeline.connect(Situ.Node.output(echo, :out), echo, :back)
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    assert report.errors == []
  end
end
