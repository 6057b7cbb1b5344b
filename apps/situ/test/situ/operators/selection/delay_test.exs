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

  test "gives every message with its time, whatever the speed of the replay" do
    wanted = for i <- 1..20, do: {Time.ms(2 * i), i}

    for speed <- [:max, 1.0, 10.0] do
      replay = [interval: {0, Time.s(10)}, speed: speed]
      assert {speed, run(replay: replay)} == {speed, wanted}
    end
  end

  test "holds each until its creation time and the duration have passed" do
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
