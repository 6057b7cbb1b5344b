defmodule Situ.Operators.SourcesTest do
  # Source cases that the conformance files do not cover.
  use ExUnit.Case, async: true

  alias Situ.Time

  @moduletag :capture_log

  describe "sources" do
    test "refuse non-positive intervals and negative counts" do
      Situ.Pipeline.run(fn p ->
        assert_raise ArgumentError, fn -> Situ.from_enumerable(p, 0..2, every: 0) end
        assert_raise ArgumentError, fn -> Situ.from_enumerable(p, 0..2, every: -5) end
        assert_raise ArgumentError, fn -> Situ.repeat(p, 1, every: 10, count: -1) end
      end)

      assert Situ.to_list(&Situ.from_enumerable(&1, [], every: 10)) == []
    end

    test "emit the last item of an enumerable that ends with it" do
      for items <- [
            Stream.take(Stream.cycle(1..3), 7),
            Stream.map(1..3, & &1),
            Stream.take(1..3, 0)
          ],
          do:
            assert(
              Situ.to_list(&Situ.from_enumerable(&1, items, every: 10)) == Enum.to_list(items)
            )
    end

    test "skip items before the replay's start and stop at its end" do
      replay = [interval: {10, 30}, speed: :max]
      items = for t <- 0..50//5, do: {t, t}
      opts = [pipeline: [replay: replay]]
      assert Situ.to_list(&Situ.from_enumerable(&1, items), opts) == [10, 15, 20, 25, 30]

      assert Situ.to_list(&Situ.repeat(&1, 1, every: 10), [times: true] ++ opts) == [
               {10, 1},
               {20, 1},
               {30, 1}
             ]
    end

    test "return an error for an item that is out of order" do
      assert {:error, %{code: :time_not_increasing, meta: %{time: 2, last_time: 3}}} =
               Situ.Test.run([n: [{1, :a}, {3, :b}, {2, :c}]], & &1.n)
    end

    test "read enumerables lazily and close them" do
      me = self()

      endless =
        Stream.resource(
          fn -> 0 end,
          fn n -> {[n], n + 1} end,
          fn n -> send(me, {:closed, n}) end
        )

      stream = Situ.to_stream(&Situ.from_enumerable(&1, endless, every: 10))
      assert Enum.take(stream, 3) == [0, 1, 2]
      assert_receive {:closed, n} when n < 200_000
    end

    test "an error in the middle of reading reaches the reader" do
      stream =
        Situ.to_stream(fn p ->
          p |> Situ.from_enumerable(0..4, every: 10) |> Situ.map(&(6 / (&1 - 3)))
        end)

      assert_raise Situ.Error, ~r/Map failed/, fn -> Enum.to_list(stream) end
    end

    test "events at the same time are nudged or dropped" do
      for {policy, expected} <- [nudge: [{0, :a}, {1, :b}], drop: [{0, :a}]] do
        me = self()

        test =
          Situ.Test.start([], fn _, p ->
            Situ.event_source(p, &send(me, {:post, &1}),
              unsubscribe: fn _ -> send(me, :left) end,
              on_same_time: policy
            )
          end)

        assert_receive {:post, post}
        post.(:a)
        post.(:b)
        Situ.Test.settle(test)
        Situ.Test.advance(test, 1)
        assert Situ.Test.outputs(test) == expected
        Situ.Test.stop(test)
        assert_receive :left
      end
    end

    test "events posted before a stop are delivered in order of their times" do
      me = self()

      {:ok, p} =
        Situ.Pipeline.start(
          fn p ->
            p
            |> Situ.event_source(&send(me, {:post, &1}))
            |> Situ.each(&send(me, {:got, &2.originating_time, &1}))
          end,
          []
        )

      assert_receive {:post, post}, 5_000
      posters = for k <- 1..4, do: Task.async(fn -> for n <- 1..2_500, do: post.({k, n}) end)
      Task.await_many(posters)
      assert {:ok, _} = Situ.Pipeline.stop(p)
      got = received([])
      assert length(got) == 10_000
      assert got == Enum.sort_by(got, &elem(&1, 0))
      for k <- 1..4, do: assert(for({_, {^k, n}} <- got, do: n) == Enum.to_list(1..2_500))
    end

    test "timers follow the clock and do not make up for missed ticks" do
      test = Situ.Test.start([], fn _, p -> Situ.timer(p, every: Time.ms(10)) end)
      for _ <- 1..3, do: Situ.Test.advance(test, Time.ms(10))
      Situ.Test.advance(test, Time.ms(35))
      times = for {t, _} <- Situ.Test.outputs(test), do: div(t, Time.ms(1))
      assert times == [10, 20, 30, 65]
      Situ.Test.stop(test)
    end
  end

  defp received(got) do
    receive do
      {:got, time, data} -> received([{time, data} | got])
    after
      0 -> Enum.reverse(got)
    end
  end
end
