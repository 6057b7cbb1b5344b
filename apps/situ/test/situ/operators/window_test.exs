defmodule Situ.Operators.WindowsTest do
  # Window cases that the conformance files do not cover.
  use ExUnit.Case, async: true

  alias Situ.Interval

  @moduletag :capture_log

  defp run(inputs, build, opts \\ []) do
    {:ok, outputs} = Situ.Test.run(inputs, build, opts)
    outputs
  end

  describe "windows" do
    test "with the left end after the right end are normalized" do
      inputs = [n: Enum.map(1..4, &{&1, &1})]
      assert run(inputs, &Situ.window(&1.n, 0..-1//-1)) == [{2, [1, 2]}, {3, [2, 3]}, {4, [3, 4]}]
      window = Interval.new(0, true, -1, true)
      assert [{1, [1]}, {2, [1, 2]} | _] = run(inputs, &Situ.window(&1.n, window))
    end

    test "after the anchor contain exactly the messages at their indices, with the anchor's time" do
      inputs = [n: Enum.map(1..5, &{&1 * 10, &1})]
      assert run(inputs, &Situ.window(&1.n, 1..2)) == [{10, [2, 3]}, {20, [3, 4]}, {30, [4, 5]}]
    end

    test "keep their look-back when the stream ends" do
      inputs = [n: Enum.map(0..3, &{&1, &1})]
      window = Interval.closed(-2, 2)
      assert List.last(run(inputs, &Situ.window(&1.n, window))) == {3, [1, 2, 3]}
    end

    test "refuse invalid windows" do
      Situ.Pipeline.run(fn p ->
        s = Situ.return(p, 1)
        assert_raise ArgumentError, ~r/a window is/, fn -> Situ.window(s, 5) end

        assert_raise ArgumentError, ~r/whole ns/, fn ->
          Situ.window(s, Interval.closed(-1, 0.5))
        end
      end)
    end

    test "of window_by may arrive after the source has ended" do
      test =
        Situ.Test.start(
          [:n, :w],
          fn s -> Situ.window_by(s.n, s.w, &{Interval.closed(0, &1.data), 0}) end,
          start: 1_000
        )

      Situ.Test.feed(test, :n, [{1, :a}, {2, :b}])
      Situ.Test.close(test, :n)
      Situ.Test.feed(test, :w, {5, 100})
      assert Situ.Test.outputs(test) == [{5, [:a, :b]}]
      Situ.Test.stop(test)
    end

    test "of window_by must be finite and not inverted" do
      inputs = [n: [{1, 1}], w: [{0, Interval.left_bounded(0)}]]

      assert {:error, %{code: :window_not_finite}} =
               Situ.Test.run(inputs, &Situ.window_by(&1.n, &1.w, fn m -> {m.data, 0} end))

      inputs = [n: [{1, 1}], w: [{0, Interval.closed(3, 1)}]]

      assert {:error, %{code: :window_negative}} =
               Situ.Test.run(inputs, &Situ.window_by(&1.n, &1.w, fn m -> {m.data, 0} end))
    end
  end
end
