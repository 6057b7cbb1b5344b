defmodule Situ.Operators.ParallelTest do
  # Branch cases that the conformance files do not cover.
  use ExUnit.Case, async: true

  @moduletag :capture_log

  defp run(inputs, build, opts \\ []) do
    {:ok, outputs} = Situ.Test.run(inputs, build, opts)
    outputs
  end

  describe "parallel/3" do
    test "names the branch that raised" do
      inputs = [m: [{0, %{ok: 1, bad: 0}}]]

      build =
        &Situ.parallel(&1.m, fn _key, s -> Situ.map(s, fn n -> 1 / n end, name: "Invert") end)

      assert {:error, error} = Situ.Test.run(inputs, build)
      assert error.meta.component =~ "Parallel"
      assert error.what =~ "[:bad].Invert"
    end

    test "restarts a raising branch with on_branch_error: :restart" do
      inputs = [m: [{0, %{a: 1, b: 1}}, {1, %{a: :x, b: 2}}, {2, %{a: 3, b: 3}}]]

      build =
        &Situ.parallel(&1.m, fn _key, s -> Situ.sum(s) end,
          on_branch_error: :restart,
          or_default: 0
        )

      assert run(inputs, build) == [{0, %{a: 1, b: 1}}, {1, %{b: 3}}, {2, %{a: 3, b: 6}}]
    end

    test "supports components that look ahead, in order of time" do
      inputs = [m: Enum.map(0..3, &{&1, %{a: &1, b: &1 * 10}})]
      build = &Situ.parallel(&1.m, fn _key, s -> Situ.delta(s) end)
      assert run(inputs, build) == [{0, %{a: 1, b: 10}}, {1, %{a: 1, b: 10}}, {2, %{a: 1, b: 10}}]
    end

    test "counts messages that a branch emits while it ends" do
      inputs = [m: [{0, %{a: 1}}, {1, %{a: 2}}, {2, %{}}]]
      build = &Situ.parallel(&1.m, fn _key, s -> Situ.last(s) end)
      assert run(inputs, build) == [{1, %{a: 2}}, {2, %{}}]
    end

    test "a variable form follows the length of its input, including empty lists" do
      inputs = [l: [{0, [1, 2]}, {1, []}, {2, [3, 4, 5]}, {3, [6]}]]
      build = &Situ.parallel(&1.l, fn s -> Situ.sum(s) end, of: :lists)
      assert run(inputs, build) == [{0, [1, 2]}, {1, []}, {2, [4, 6, 5]}, {3, [10]}]
    end

    test "in a fixed form the first branch may drop, and a different length is an error" do
      build =
        &Situ.parallel(&1.l, fn s -> Situ.filter(s, fn n -> n > 1 end) end, size: 2, or_default: 0)

      assert run([l: [{0, [1, 2]}]], build) == [{0, [0, 2]}]
      assert {:error, %{code: :wrong_length}} = Situ.Test.run([l: [{0, [1]}]], build)
    end

    test "ends a branch after n absences in a row, and a presence resets the count" do
      maps = [%{a: 1}, %{}, %{a: 1}, %{}, %{a: 1}, %{}, %{}]
      inputs = [m: Enum.with_index(maps, fn m, i -> {i, m} end)]

      build =
        &Situ.parallel(&1.m, fn _k, s -> Situ.sum(s) end, until: {:absent, 1}, or_default: 0)

      assert Enum.map(run(inputs, build), &elem(&1, 1)) ==
               [%{a: 1}, %{a: 0}, %{a: 2}, %{a: 0}, %{a: 3}, %{a: 0}, %{}]
    end

    test "refuses sources inside a branch" do
      build =
        &Situ.parallel(&1.m, fn _k, s -> Situ.join(s, Situ.repeat(s.pipeline, 1, every: 1)) end)

      assert {:error, %{code: :not_in_branch}} = Situ.Test.run([m: [{0, %{a: 1}}]], build)
    end
  end
end
