defmodule Situ.Parallel.ProcessesTest do
  # Tests parallel with branches that are separate pipelines.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Error, Test}

  @moduletag :capture_log
  @processes [branches: :processes]

  defp run(inputs, build) do
    {:ok, outputs} = Test.run(inputs, build)
    outputs
  end

  defp indexed(list), do: Enum.with_index(list, fn item, i -> {i, item} end)

  describe "forms" do
    test "the sparse form has one branch per key while the key is present" do
      inputs = [m: [{0, %{ann: 1, bob: 5}}, {10, %{ann: 3}}, {20, %{ann: 4, bob: 9}}]]
      build = &Situ.parallel(&1.m, fn _key, s -> Situ.sum(s) end, @processes)

      assert run(inputs, build) == [
               {0, %{ann: 1, bob: 5}},
               {10, %{ann: 4}},
               {20, %{ann: 8, bob: 9}}
             ]
    end

    test "the fixed and variable forms sum each element" do
      inputs = [l: [{0, [1, 2]}, {1, [3, 4]}]]
      build = &Situ.parallel(&1.l, fn s -> Situ.sum(s) end, [size: 2] ++ @processes)
      assert run(inputs, build) == [{0, [1, 2]}, {1, [4, 6]}]

      inputs = [l: indexed([[1, 2], [], [3, 4, 5], [6]])]
      build = &Situ.parallel(&1.l, fn s -> Situ.sum(s) end, [of: :lists] ++ @processes)
      assert run(inputs, build) == [{0, [1, 2]}, {1, []}, {2, [4, 6, 5]}, {3, [10]}]
    end

    test "without a result stream nothing is emitted, and all work is done by the end" do
      me = self()

      build = fn s ->
        Situ.parallel(
          s.m,
          fn key, s ->
            Situ.each(s, &send(me, {key, &1}))
            :nothing
          end,
          @processes
        )
      end

      assert run([m: [{0, %{a: 1}}, {1, %{a: 2, b: 3}}]], build) == []
      for seen <- [{:a, 1}, {:a, 2}, {:b, 3}], do: assert_received(^seen)
    end

    test "messages that a branch emits while it ends count" do
      inputs = [m: [{0, %{a: 1}}, {1, %{a: 2}}, {2, %{}}]]
      build = &Situ.parallel(&1.m, fn _key, s -> Situ.last(s) end, @processes)
      assert run(inputs, build) == [{1, %{a: 2}}, {2, %{}}]
    end
  end

  describe "features that require branch processes" do
    test "sources start with the branch" do
      inputs = [m: [{5, %{a: 1}}, {15, %{a: 2, b: 3}}, {25, %{b: 4}}]]

      build = fn s ->
        Situ.parallel(
          s.m,
          fn _key, part ->
            Situ.join(part, Situ.from_enumerable(part.pipeline, 100..1099, every: 10))
          end,
          @processes
        )
      end

      assert run(inputs, build) == [
               {5, %{a: {1, 100}}},
               {15, %{a: {2, 101}, b: {3, 100}}},
               {25, %{b: {4, 101}}}
             ]

      assert {:error, %{code: :not_in_branch, fix: fix}} =
               Test.run(inputs, fn s ->
                 Situ.parallel(s.m, fn _, part -> Situ.repeat(part.pipeline, 1, every: 1) end)
               end)

      assert fix =~ "branches: :processes"
    end

    test "delays follow the clock of the surrounding pipeline" do
      test = Test.start([:m], &Situ.parallel(&1.m, fn _, s -> Situ.delay(s, 50) end, @processes))

      Test.feed(test, :m, [{0, %{a: 1, b: 2}}])
      assert Test.outputs(test) == []
      Test.advance(test, 49)
      assert Test.outputs(test) == []
      Test.advance(test, 1)
      assert Test.outputs(test) == [{0, %{a: 1, b: 2}}]
      assert {:ok, _} = Test.stop(test)
    end

    test "operators run in separate processes for each branch" do
      inputs = [m: [{0, %{a: 1, b: 2}}, {1, %{a: 1, b: 2}}]]

      build =
        &Situ.parallel(
          &1.m,
          fn _, s ->
            s |> Situ.map(fn _ -> self() end) |> Situ.map(fn p -> {p, self()} end, async: true)
          end,
          @processes
        )

      assert [{0, %{a: {a1, a2}, b: {b1, b2}}}, {1, %{a: {a1, a2}, b: {b1, b2}}}] =
               run(inputs, build)

      assert [a1, a2, b1, b2] == Enum.uniq([a1, a2, b1, b2])
      refute Enum.any?([a1, a2, b1, b2], &Process.alive?/1)
    end

    test "branches can be nested" do
      inputs = [m: [{0, %{a: %{x: 1}, b: %{y: 2}}}, {1, %{a: %{x: 3, z: 4}}}]]
      inner = fn opts -> fn _, s -> Situ.parallel(s, fn _, s -> Situ.sum(s) end, opts) end end

      for opts <- [[], @processes] do
        build = &Situ.parallel(&1.m, inner.([of: :maps] ++ opts), @processes)
        assert run(inputs, build) == [{0, %{a: %{x: 1}, b: %{y: 2}}}, {1, %{a: %{x: 4, z: 4}}}]
      end

      build = &Situ.parallel(&1.m, inner.([of: :maps] ++ @processes))
      assert {:error, %{code: :not_in_branch}} = Test.run(inputs, build)
    end
  end

  describe "waiting" do
    test "does not wait for a chain of light operators that emits nothing" do
      test =
        Test.start(
          [:m],
          &Situ.parallel(
            &1.m,
            fn _, s -> Situ.filter(s, fn n -> n > 1 end) end,
            [or_default: :none, until: {:absent, 1}] ++ @processes
          )
        )

      Test.feed(test, :m, [{0, %{a: 1, b: 2}}])
      assert Test.outputs(test) == [{0, %{a: :none, b: 2}}]
      Test.advance(test, 1)
      Test.feed(test, :m, [{1, %{b: 2}}])
      assert Test.outputs(test) == [{1, %{a: :none, b: 2}}]
      Test.stop(test)
    end

    test "a branch that needs more messages than fit in one window receives them" do
      inputs = [l: indexed(for n <- 1..1_500, do: [n])]

      build = fn s ->
        Situ.parallel(
          s.l,
          fn part -> part |> Situ.window(0..700, &length/1) |> Situ.map(& &1, async: true) end,
          [size: 1] ++ @processes
        )
      end

      outputs = run(inputs, build)
      assert length(outputs) == 800
      assert Enum.all?(outputs, fn {_, [n]} -> n == 701 end)
    end

    test "a slow branch holds back its input" do
      me = self()

      build = fn p ->
        p
        |> Situ.from_enumerable(0..4999, every: 1)
        |> Situ.map(&[&1])
        |> Situ.parallel(
          fn s ->
            Situ.map(s, fn n ->
              if n == 10, do: send(me, {:stuck, self()}) && receive(do: (:go_on -> n)), else: n
            end)
          end,
          [size: 1] ++ @processes
        )
        |> Situ.count()
        |> Situ.last()
        |> Situ.each(&send(me, {:counted, &1}))
      end

      {:ok, pipeline} = Situ.Pipeline.start(build, pipeline: [replay: [speed: :max]])
      assert_receive {:stuck, branch}
      at_rest(stages(pipeline), nil)
      edges = Situ.Pipeline.info(pipeline).edges
      # The limit is two demand windows plus the messages that the operator holds.
      assert Enum.max(Enum.map(edges, & &1.emitted)) < 3_500
      send(branch, :go_on)
      assert_receive {:counted, 5_000}, 60_000
      Situ.Pipeline.await(pipeline)
    end

    # Returns all stages except the operator itself, which polls its held messages.
    defp stages(pipeline) do
      {:links, links} = Process.info(pipeline, :links)

      for pid <- links,
          is_pid(pid),
          %Situ.Stage.State{steps: {%{worker: %{module: module}}}} <- [:sys.get_state(pid)],
          module != Situ.Parallel.Component,
          do: pid
    end

    # Waits until the processes are idle: empty mailboxes and no work since the last check.
    defp at_rest(pids, before) do
      now = Enum.map(pids, &Process.info(&1, [:status, :message_queue_len, :reductions]))
      waiting? = Enum.all?(now, &match?([{:status, :waiting}, {:message_queue_len, 0}, _], &1))
      if waiting? and now == before, do: :ok, else: at_rest(pids, now)
    end
  end

  describe "at the end" do
    test "waits for busy branches and does not treat them as stuck" do
      me = self()

      slow = fn n ->
        send(me, {:at, n, self()})
        receive do: (:go_on -> n)
      end

      build = fn p ->
        p
        |> Situ.from_enumerable(0..2, every: 1)
        |> Situ.map(&[&1])
        |> Situ.parallel(fn s -> Situ.map(s, slow) end, [size: 1] ++ @processes)
        |> Situ.each(&send(me, {:out, &1}))
      end

      {:ok, pipeline} = Situ.Pipeline.start(build, pipeline: [replay: [speed: :max]])

      # The pipeline detects progress by this mark, which must change after each step.
      Enum.reduce(0..2, nil, fn n, before ->
        assert_receive {:at, ^n, branch}
        ending(pipeline)
        mark = moved(pipeline, before)
        send(branch, :go_on)
        mark
      end)

      assert {:ok, _} = Situ.Pipeline.await(pipeline)
      for n <- 0..2, do: assert_received({:out, [^n]})
    end

    defp moved(pipeline, before) do
      mark = Situ.Pipeline.Client.call(pipeline, :mark)
      if mark == before, do: moved(pipeline, before), else: mark
    end

    defp ending(pipeline),
      do: if(Situ.Pipeline.state(pipeline) != :stopping, do: ending(pipeline), else: :ok)
  end

  describe "a failing branch" do
    test "fails the operator with an error that names the branch" do
      build =
        &Situ.parallel(
          &1.m,
          fn _, s -> Situ.map(s, fn n -> 1 / n end, name: "Invert") end,
          @processes
        )

      assert {:error, %Error{} = error} = Test.run([m: [{0, %{ok: 1, bad: 0}}]], build)
      assert error.what =~ "Parallel[:bad].Invert"
    end

    test "ends the branches that started with it if it fails while being built" do
      me = self()

      build = fn s ->
        Situ.parallel(
          s.m,
          fn
            :bad, _ ->
              raise "no such key"

            _, s ->
              send(me, {:branch, s.pipeline.pid})
              s
          end,
          [on_error: :skip] ++ @processes
        )
      end

      test = Test.start([:m], build)
      Test.feed(test, :m, [{0, %{a: 1, bad: 0}}])
      assert_receive {:branch, pid}
      monitor = Process.monitor(pid)
      assert_receive {:DOWN, ^monitor, :process, ^pid, _}
      assert {:ok, %{skipped: %{"Parallel" => 1}}} = Test.stop(test)
    end

    test "restarts alone with on_branch_error: :restart and loses its messages in flight" do
      test =
        Test.start(
          [:m],
          &Situ.parallel(
            &1.m,
            fn _, s -> Situ.sum(s) end,
            [on_branch_error: :restart, or_default: 0] ++ @processes
          ),
          start: 100
        )

      for {time, map} <- [{0, %{a: 1, b: 1}}, {1, %{a: :x, b: 2}}, {2, %{a: 3, b: 3}}],
          do: Test.feed(test, :m, {time, map})

      assert Test.outputs(test) == [
               {0, %{a: 1, b: 1}},
               {1, %{a: 0, b: 3}},
               {2, %{a: 3, b: 6}}
             ]

      node = Enum.find(Situ.Pipeline.info(test.pipeline).nodes, &(&1.path == "Parallel"))
      Test.settle(test)
      described = Situ.Pipeline.info(test.pipeline).nodes |> Enum.find(&(&1.id == node.id))

      assert described.description =~
               "2 branches live, each its own pipeline, 3 started, 1 failed"

      Test.stop(test)
    end

    test "that is killed is handled by on_error" do
      for {on_error, ends} <- [stop: :error, skip: :ok] do
        test =
          Test.start(
            [:m],
            &Situ.parallel(
              &1.m,
              fn _, s -> Situ.map(s, fn n -> {n, s.pipeline.pid} end) end,
              [on_error: on_error] ++ @processes
            ),
            start: 100
          )

        Test.feed(test, :m, {0, %{a: 1}})
        assert [{0, %{a: {1, pid}}}] = Test.outputs(test)
        monitor = Process.monitor(pid)
        Process.exit(pid, :kill)
        assert_receive {:DOWN, ^monitor, :process, ^pid, :killed}
        Test.settle(test)
        Test.feed(test, :m, {1, %{a: 2}})
        if on_error == :skip, do: assert([{1, %{a: {2, _}}}] = Test.outputs(test))
        assert {^ends, _} = Test.stop(test)
      end
    end

    test "ends when the operator is killed" do
      me = self()

      build = fn s ->
        Situ.parallel(
          s.m,
          fn _, s ->
            send(me, {:branch, s.pipeline.pid})
            s
          end,
          @processes
        )
      end

      test = Test.start([:m], build)
      Test.feed(test, :m, [{0, %{a: 1, b: 2}}])
      monitors = for _ <- 1..2, do: assert_receive({:branch, pid}) && Process.monitor(pid)

      {:links, links} = Process.info(test.pipeline, :links)

      for pid <- links,
          is_pid(pid),
          match?(
            %Situ.Stage.State{steps: {%{worker: %{module: Situ.Parallel.Component}}}},
            :sys.get_state(pid)
          ),
          do: Process.exit(pid, :kill)

      for monitor <- monitors, do: assert_receive({:DOWN, ^monitor, :process, _, _})
      assert {:error, %{code: :component_killed}} = Test.stop(test)
    end
  end

  describe "branches as values and as processes" do
    @kinds [:sum, :filter, :last, :window, :delta, :later, :async, :drop_all, :average]

    property "emit the same maps at the same times", numtests: 60 do
      forall {kind, maps, until, default, present} <-
               {one_of(@kinds), timed_values(keyed(), 4),
                one_of([:absent, {:absent, 1}, {:absent, 3}, :never, &end_branch/3]),
                one_of([:drop, 0]), boolean()} do
        opts = [of: :maps, until: until, only_present: present]
        opts = if default == :drop, do: opts, else: [or_default: default] ++ opts
        assert both([m: maps], kind, opts)
      end
    end

    property "emit the same lists", numtests: 30 do
      forall {kind, lists, default} <-
               {one_of(@kinds), timed_values(list(integer(-9, 9)), 4), one_of([:drop, 0])} do
        opts = if default == :drop, do: [of: :lists], else: [of: :lists, or_default: default]
        assert both([m: lists], kind, opts)
      end
    end

    # Ends branches whether or not their keys are present.
    defp end_branch(key, map, time),
      do: if(rem(map_size(map) + key, 3) == 0, do: {:close, time}, else: :keep)

    defp keyed do
      map(list({integer(0, 3), integer(-9, 9)}), &Map.new/1)
    end

    defp both(inputs, kind, opts) do
      build = fn opts -> &Situ.parallel(&1.m, fn s -> branch(kind, s) end, opts) end
      run(inputs, build.(opts)) == run(inputs, build.(opts ++ @processes))
    end

    defp branch(:sum, s), do: Situ.sum(s)
    defp branch(:filter, s), do: Situ.filter(s, &(rem(&1, 2) == 0))
    defp branch(:last, s), do: Situ.last(s, 2)
    defp branch(:window, s), do: Situ.window(s, 0..1, &Enum.sum/1)
    defp branch(:delta, s), do: Situ.delta(s)
    defp branch(:drop_all, s), do: s |> Situ.window(0..1) |> Situ.filter(fn _ -> false end)
    defp branch(:average, s), do: Situ.average(s, over: {:past, 3})
    defp branch(:async, s), do: s |> Situ.map(&(&1 * 2), async: true) |> Situ.sum(async: true)

    defp branch(:later, s) do
      s
      |> Situ.join(Situ.filter(s, &(&1 > 0)), Situ.Reproducible.nearest())
      |> Situ.map(&Tuple.sum/1)
    end
  end
end
