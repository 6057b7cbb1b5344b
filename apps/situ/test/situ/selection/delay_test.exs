defmodule Situ.Selection.DelayTest do
  use ExUnit.Case, async: true

  alias Situ.{Pipeline, Time}

  defp run(settings) do
    me = self()

    build = fn p ->
      p
      |> Situ.from_enumerable(for i <- 1..20, do: {Time.ms(2 * i), i})
      |> Situ.map(& &1, async: true)
      |> Situ.delay(Time.ms(7))
      |> Situ.each(&send(me, {:got, &2.originating_time, &1}))
    end

    {:ok, _} = Pipeline.run(build, pipeline: settings)
    collect([])
  end

  defp collect(got) do
    receive do
      {:got, time, data} -> collect([{time, data} | got])
    after
      0 -> Enum.reverse(got)
    end
  end

  test "emits every message with its time at any replay speed" do
    wanted = for i <- 1..20, do: {Time.ms(2 * i), i}

    for speed <- [:max, 1.0, 10.0] do
      replay = [interval: {0, Time.s(10)}, speed: speed]
      assert {speed, run(replay: replay)} == {speed, wanted}
    end
  end

  # Runs a finite stream with a manual clock and a delay of 50, and waits until the first of two messages was emitted.
  defp ending(clock, stop_timeout) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable([{0, :a}, {20, :b}])
          |> Situ.each(&send(me, {:made, &1}), async: true)
          |> Situ.delay(50)
          |> Situ.each(&send(me, {:got, &2.originating_time, &1}))
        end,
        pipeline: [clock: clock, replay: [interval: {0, :unbounded}], stop_timeout: stop_timeout]
      )

    assert_receive {:made, :a}, 30_000
    p
  end

  test "keeps holding messages after the stream ends, despite the stop timeout" do
    clock = Situ.Clock.manual(0)
    p = ending(clock, 200)

    # This is the source's last message, so it ends. The clock then pauses for longer than the stop timeout.
    Situ.Clock.set(clock, 20)
    assert_receive {:made, :b}, 30_000
    refute_receive {:got, _, _}, 500
    Situ.Clock.set(clock, 69)
    assert_receive {:got, 0, :a}, 30_000
    refute_receive {:got, _, _}, 100
    Situ.Clock.set(clock, 70)
    assert_receive {:got, 20, :b}, 30_000
    assert {:ok, %{errors: []}} = Pipeline.await(p, 30_000)
  end

  test "emits held messages when the pipeline is stopped, even shortly before its end" do
    for made <- [[], [:b]] do
      clock = Situ.Clock.manual(0)
      p = ending(clock, 30_000)
      if made != [], do: Situ.Clock.set(clock, 20)
      for data <- made, do: assert_receive({:made, ^data}, 30_000)
      refute_receive {:got, _, _}, 100
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
      assert [{0, :a} | _] = got = collect([])
      assert length(got) == 1 + length(made)
    end
  end

  test "holds each message until its creation time plus the duration" do
    test = Situ.Test.start([:in], fn s -> Situ.delay(s.in, 50) end)
    Situ.Test.feed(test, :in, [{0, :a}])
    Situ.Test.advance(test, 20)
    Situ.Test.feed(test, :in, [{20, :b}])
    assert Situ.Test.outputs(test) == []
    Situ.Test.advance(test, 30)
    assert Situ.Test.outputs(test) == [{0, :a}]
    Situ.Test.advance(test, 19)
    assert Situ.Test.outputs(test) == []
    Situ.Test.advance(test, 1)
    assert Situ.Test.outputs(test) == [{20, :b}]
    Situ.Test.stop(test)
  end
end
