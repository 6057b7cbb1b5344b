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

    test "an output lacks only the key whose branch a function ends, even if the key is present" do
      until = fn key, map, time -> if map[key] == :end, do: {:close, time}, else: :keep end
      maps = [m: [{0, %{a: 1, b: 1}}, {1, %{a: :end, b: 2}}, {2, %{a: 3, b: 3}}]]
      count = fn _key, s -> Situ.count(s) end
      expected = [{0, %{a: 1, b: 1}}, {1, %{b: 2}}, {2, %{a: 1, b: 3}}]

      for branches <- [:values, :processes] do
        build = &Situ.parallel(&1.m, count, until: until, branches: branches)
        assert run(maps, build) == expected
      end
    end

    test "calls the function for each branch, also if all are built alike" do
      me = self()

      build = fn s ->
        Situ.parallel(
          s.m,
          fn part ->
            send(me, :built)
            Situ.map(part, &(&1 + 1))
          end,
          of: :maps
        )
      end

      assert run([m: [{0, %{a: 1, b: 2}}, {1, %{a: 1, c: 3}}]], build) ==
               [{0, %{a: 2, b: 3}}, {1, %{a: 2, c: 4}}]

      for _ <- 1..3, do: assert_received(:built)
      refute_received :built
    end

    test "names the node that is not connected" do
      build = fn s ->
        Situ.parallel(s.m, fn _, part -> part end, branches: {:nodes, fn _ -> :nobody@nowhere end})
      end

      assert {:error, %{code: :branch_node_down} = error} =
               Situ.Test.run([m: [{0, %{a: 1}}]], build)

      assert error.what =~ "Parallel[:a] cannot start on nobody@nowhere"
    end

    defmodule Twice do
      use Situ.Component, inputs: [in: :any], outputs: [out: :any]

      @impl true
      def handle_message(:in, %{originating_time: time, data: data}, _context, state),
        do: {[{:out, [time, time + 1], [data, -data]}], state}
    end

    test "a component inside a branch may emit several messages together" do
      me = self()

      build = fn inputs ->
        Situ.parallel(inputs.m, fn _key, stream ->
          stream |> Situ.via(Twice) |> Situ.each(&send(me, {:twice, &1}))
        end)
      end

      assert {:ok, _} = Situ.Test.run([m: [{0, %{a: 1}}]], build)
      assert_received {:twice, 1}
      assert_received {:twice, -1}
    end

    test "refuses sources inside a branch" do
      build =
        &Situ.parallel(&1.m, fn _k, s -> Situ.join(s, Situ.repeat(s.pipeline, 1, every: 1)) end)

      assert {:error, %{code: :not_in_branch}} = Situ.Test.run([m: [{0, %{a: 1}}]], build)
    end
  end
end
