defmodule Situ.Store.ImporterTest do
  # Pipelines replay stores: intervals, clocks, speeds, several stores at a time, and loops.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Play
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  test "replays an interval with both ends, also beyond the recording", %{tmp_dir: root} do
    path = record(root, "rec", 0..99)
    ms = &(&1 * 1_000_000)

    values = fn interval ->
      path |> replay("seq", replay: [interval: interval]) |> Enum.map(& &1.data)
    end

    assert values.({ms.(90), ms.(95)}) == Enum.to_list(90..95)
    assert values.({ms.(90) - 5, :unbounded}) == Enum.to_list(90..99)
    assert values.({ms.(90) + 1, ms.(93) - 1}) == [91, 92]
    assert values.({:unbounded, ms.(3)}) == [0, 1, 2, 3]
    assert values.({ms.(1_000), ms.(2_000)}) == []
  end

  test "a replay follows the recording's times at any speed", %{tmp_dir: root} do
    path = record(root, "rec", 0..99)

    for {speed, least} <- [{1.0, 95}, {4.0, 22}] do
      started = System.monotonic_time(:millisecond)
      got = replay(path, "seq", replay: [speed: speed])
      took = System.monotonic_time(:millisecond) - started
      assert length(got) == 100
      assert took >= least
    end
  end

  test "derived streams are the same at every speed", %{tmp_dir: root} do
    fast = for i <- 0..599, do: {i * 1_000_000, i}
    slow = for i <- 0..59, do: {i * 10_000_000 + 300_000, i * 1.5}

    {:ok, report} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "two", root)
        p |> Situ.from_enumerable(fast) |> Store.write(exporter, "fast")
        p |> Situ.from_enumerable(slow) |> Store.write(exporter, "slow")
        exporter.path
      end)

    derive = fn replay ->
      test = self()

      {:ok, report} =
        Pipeline.run(
          fn p ->
            importer = Store.importer(p, report.result)

            importer
            |> Store.stream("fast")
            |> Situ.join(
              Store.stream(importer, "slow"),
              Situ.Reproducible.nearest(Situ.Time.ms(4))
            )
            |> Situ.filter(fn {i, _} -> rem(i, 3) != 0 end)
            |> Situ.scan({0, 0.0}, fn {i, x}, {n, sum} -> {n + i, sum + x} end)
            |> collect(test)
          end,
          pipeline: [replay: replay]
        )

      for m <- received(report.result), do: {m.originating_time, m.data}
    end

    reference = derive.(speed: :max)
    assert length(reference) > 300
    for speed <- [1.0, 4.0], do: assert(derive.(speed: speed) == reference)
  end

  test "messages arrive exactly when a manual clock reaches their times", %{tmp_dir: root} do
    path = record(root, "rec", 0..9)
    clock = Situ.Clock.manual(0)
    test = self()

    {:ok, p} =
      Pipeline.start_link(
        fn p ->
          p
          |> Store.importer(path)
          |> Store.stream("seq")
          |> Situ.each(fn data -> send(test, {:got, data}) end)
        end,
        pipeline: [clock: clock, replay: [speed: 1.0]]
      )

    assert_receive {:got, 0}
    refute_received {:got, 1}
    Situ.Clock.advance(clock, 3_000_000)
    for n <- 1..3, do: assert_receive({:got, ^n})
    refute_received {:got, 4}
    Situ.Clock.advance(clock, 6_000_000)
    for n <- 4..9, do: assert_receive({:got, ^n})
    assert {:ok, _} = Pipeline.await(p, 30_000)
  end

  test "replays several stores on one clock", %{tmp_dir: root} do
    a = record(root, "a", 0..49)
    b = record(root, "b", 100..149)

    test = self()

    {:ok, report} =
      Pipeline.run(fn p ->
        for path <- [a, b], do: p |> Store.importer(path) |> Store.stream("seq") |> collect(test)
      end)

    assert [first, second] = Enum.map(report.result, &received/1)
    assert {length(first), length(second)} == {50, 50}
  end

  test "a loop starts over with later times", %{tmp_dir: root} do
    path = record(root, "rec", 0..4)
    test = self()

    {:ok, p} =
      Pipeline.start_link(
        fn p ->
          p
          |> Store.importer(path, loop: 10_000_000)
          |> Store.stream("seq")
          |> Situ.each(fn data, m -> send(test, {:got, data, m.originating_time}) end)
        end,
        pipeline: [replay: [interval: {0, 22_000_000}, speed: :max]]
      )

    assert {:ok, _} = Pipeline.await(p, 30_000)

    for round <- 0..1, n <- 0..4 do
      time = round * 10_000_000 + n * 1_000_000
      assert_received {:got, ^n, ^time}
    end

    for n <- 0..2, do: assert_received({:got, ^n, _})
    refute_received {:got, _, _}
  end

  test "refuses a loop shorter than the recording at build time", %{tmp_dir: root} do
    path = record(root, "rec", 0..99)
    build = fn p -> p |> Store.importer(path, loop: 99_000_000) |> Store.stream("seq") end
    assert {:error, %{code: :bad_option, why: why}} = Pipeline.run(build)
    assert why =~ "99.0 ms"
  end
end
