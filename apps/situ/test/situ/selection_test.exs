defmodule Situ.SelectionTest do
  # Cases that the conformance files do not cover, for operators that select and hold messages.
  use ExUnit.Case, async: true

  @moduletag :capture_log

  defp run(inputs, build, opts \\ []) do
    {:ok, outputs} = Situ.Test.run(inputs, build, opts)
    outputs
  end

  describe "selection" do
    test "delay/3 holds messages by the clock and keeps their times" do
      test = Situ.Test.start([:n], &Situ.delay(&1.n, 50))
      Situ.Test.feed(test, :n, [{0, :a}, {10, :b}])
      assert Situ.Test.outputs(test) == []
      Situ.Test.advance(test, 50)
      assert Situ.Test.outputs(test) == [{0, :a}]
      Situ.Test.advance(test, 50)
      assert Situ.Test.outputs(test) == [{10, :b}]
      Situ.Test.stop(test)
    end

    test "process/4 emits any number of messages, including some at the end" do
      build = fn s ->
        Situ.process(
          s.text,
          0,
          fn m, n ->
            {Enum.with_index(String.split(m.data), &{m.originating_time + &2, &1}), n + 1}
          end,
          on_close: fn time, n -> [{time + 100, n}] end
        )
      end

      assert [{0, "a"}, {1, "b"}, {10, "c"} | _] =
               run([text: [{0, "a b"}, {10, "c"}, {20, ""}]], build)
    end

    test "reorder/3 sorts late messages, up to its bound" do
      arrivals = Enum.with_index([5, 3, 9, 8, 20, 2], &{100 + &2, &1})
      build = &Situ.reorder(&1.n, 4, time: fn m -> m.data end)
      assert run([n: arrivals], build) == [{3, 3}, {5, 5}, {8, 8}, {9, 9}, {20, 20}]
      build = &Situ.reorder(&1.n, 4, time: fn m -> m.data end, late: :error)
      assert {:error, %{code: :late}} = Situ.Test.run([n: arrivals], build)
    end
  end
end
