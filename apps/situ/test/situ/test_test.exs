defmodule Situ.TestTest do
  use ExUnit.Case, async: true
  import Situ.Test, only: :macros
  alias Situ.{Test, Time}

  defp start_double do
    t = Test.start([:n], fn %{n: n} -> Situ.map(n, &(&1 * 2)) end)
    on_exit(fn -> Situ.Pipeline.stop(t.pipeline) end)
    t
  end

  defp failure(fun), do: assert_raise(ExUnit.AssertionError, fun).message

  describe "assert_emits" do
    test "takes one message at a time, in order" do
      t = start_double()
      Test.feed(t, :n, [{0, 1}, {0 + 1, 2}, {2, 3}])
      Test.advance(t, 2)
      expected = 2
      assert assert_emits(t, {0, ^expected}) == {0, 2}
      assert_emits(t, {time, 4})
      assert time == 1
      # The rest is still there.
      assert Test.outputs(t) == [{2, 6}]
      assert_emits(t, [])
    end

    test "matches lists, guards, and all messages" do
      t = start_double()
      Test.feed(t, :n, for(i <- 0..5, do: {i, i}))
      Test.advance(t, 10)
      assert_emits(t, [{0, 0}, {1, two}])
      assert two == 2
      assert_emits(t, {2, four} when four > 3)
      assert_emits(t, [{3, 6} | rest])
      assert rest == [{4, 8}, {5, 10}]
    end

    test "shows the pattern, the value and the clock when it fails" do
      t = start_double()
      assert failure(fn -> assert_emits(t, {0, 2}) end) =~ "nothing was emitted"
      Test.feed(t, :n, {0, 1})
      error = assert_raise ExUnit.AssertionError, fn -> assert_emits(t, {0, 3}) end
      assert {error.right, error.message} == {{0, 2}, "match (=) failed"}
      Test.advance(t, Time.ms(3))
      Test.feed(t, :n, {Time.ms(2), 1})
      error = assert_raise ExUnit.AssertionError, fn -> assert_emits(t, {_, n} when n > 5) end
      assert {error.left, Macro.to_string(error.expr)} == {2, "assert n > 5"}
      assert failure(fn -> assert_emits(t, _) end) =~ "the clock is at 3.00 ms"
    end

    test "names one of several outputs" do
      t =
        Test.start([:n], fn %{n: n} ->
          %{low: Situ.filter(n, &(&1 < 5)), high: Situ.filter(n, &(&1 > 5))}
        end)

      Test.feed(t, :n, [{0, 1}, {1, 9}])
      Test.advance(t, 1)
      assert_emits(t, {1, 9}, output: :high)
      assert_emits(t, {0, 1}, output: :low)
      refute_emits(t, _, output: :low)
      assert_raise ArgumentError, ~r/several outputs.*:high, :low/, fn -> assert_emits(t, _) end
      assert_raise ArgumentError, ~r/no output :left/, fn -> assert_emits(t, _, output: :left) end
      assert Test.outputs(t) == %{low: [], high: []}
      {:ok, _} = Test.stop(t)
    end
  end

  describe "await_emits" do
    test "passes through the times of timers and fed messages, in no real time" do
      t =
        Test.start([:door], fn %{door: door}, p ->
          Situ.merge([door, Situ.sequence(p, 0, &(&1 + 1), every: Time.s(1))])
        end)

      Test.feed(t, :door, [{Time.s(5) + 1, :open}])
      await_emits(t, {time, %{data: :open}})
      assert time == Time.s(5) + 1
      assert Situ.Clock.now(t.clock) == time
      await_emits(t, {_, %{data: n}} when rem(n, 4) == 0)
      assert n == 8
      assert failure(fn -> await_emits(t, {_, :closed}, within: Time.s(3)) end) =~ "within 3.00 s"
      assert Situ.Clock.now(t.clock) == Time.s(11)
      {:ok, _} = Test.stop(t)
    end

    test "fails immediately when nothing more can happen" do
      t = start_double()
      message = failure(fn -> await_emits(t, {_, 1}, within: Time.h(1000)) end)
      assert message =~ "no message matched {_, 1} and nothing more will happen"
    end

    test "finds what branches in processes of their own emit" do
      t =
        Test.start([:keys], fn %{keys: keys} ->
          Situ.parallel(
            keys,
            fn _key, branch -> Situ.map(branch, &(&1 + 1)) end,
            branches: :processes
          )
        end)

      Test.feed(t, :keys, {Time.ms(1), %{a: 1}})
      await_emits(t, {_, %{a: 2}})
      {:ok, _} = Test.stop(t)
    end
  end

  test "unknown options are errors" do
    t = start_double()
    assert_raise Situ.Error, ~r/unknown option :within/, fn -> assert_emits(t, _, within: 1) end
    assert_raise Situ.Error, ~r/did you mean :within/, fn -> await_emits(t, _, witin: 1) end
  end

  test "refute_emits leaves messages for later assertions" do
    t = start_double()
    refute_emits(t)
    Test.feed(t, :n, {0, 1})
    refute_emits(t, {_, 3})
    assert failure(fn -> refute_emits(t) end) =~ "{0, 2} matches _"
    assert failure(fn -> refute_emits(t, {_, n} when n > 1) end) =~ "{0, 2} matches"
    assert_emits(t, {0, 2})
    refute_emits(t)
  end
end
