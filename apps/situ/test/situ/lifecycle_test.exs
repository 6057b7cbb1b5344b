defmodule Situ.LifecycleTest do
  # Tests the life cycle without processes: random graphs and random events in random order.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Fixture.LifecycleWorld, as: World

  # Generates up to four sources (some endless), other stages, and links among them, some of them backwards.
  defp graph do
    {list(one_of([integer(1, 100), :infinity, nil])), list(one_of([:stop, :skip, :restart])),
     list({integer(1, 9), integer(1, 9)})}
  end

  defp made({sources, others, pairs}) do
    sources = Enum.take(sources, 4)
    others = Enum.take(others, 6)
    {s, n} = {length(sources), length(sources) + length(others)}

    links = for {a, b} <- pairs, others != [], n > 0, do: {rem(a, n) + 1, s + rem(b, n - s) + 1}

    # Connects every stage without an input to a source.
    fed = MapSet.new(links, &elem(&1, 1))
    rest = for id <- (s + 1)..n//1, s > 0, not MapSet.member?(fed, id), do: {rem(id, s) + 1, id}

    %{
      sources: sources,
      others: if(s > 0, do: others, else: []),
      links: if(s > 0, do: links ++ rest, else: [])
    }
  end

  defp wish do
    one_of([
      {:stop, integer(0, 5)},
      {:stop_at, integer(0, 200)},
      {:kill, integer(1, 10)},
      {:fail, integer(1, 10)},
      {:refuse, integer(1, 10)},
      {:part, list(integer(1, 10))},
      {:remove, list(one_of([integer(1, 10), integer(100, 104)]))},
      {:grow, one_of([:stop, :restart])},
      {:tap, integer(0, 1)},
      :untap,
      :moving
    ])
  end

  # A life with endless sources ends only with a stop.
  defp live({spec, wishes, seed}), do: World.live(made(spec), [{:stop, 3} | wishes], seed)

  defp lives, do: {graph(), list(wish()), integer(1, 1_000_000)}

  property "never gets stuck and ends exactly once", numtests: 150 do
    forall spec <- lives() do
      world = live(spec)
      assert world.life.phase == :completed
      assert world.bag == []
      assert Enum.count(world.log, &(&1 == {:action, :finished})) == 1
      assert Enum.count(world.log, &(&1 == {:action, {:handle, :completed}})) == 1
    end
  end

  # `{:refuse, id}` and `{:kill, id}` refer to added stages, which the world numbers from 100.
  property "sends the server no action for a dropped stage, and drops every removed stage",
    numtests: 150 do
    changes = [
      {:remove, list(one_of([integer(1, 10), integer(100, 104)]))},
      {:grow, :restart},
      {:part, list(integer(1, 10))},
      {:tap, 1},
      :untap,
      {:kill, integer(100, 104)},
      {:refuse, integer(100, 104)}
    ]

    forall {spec, wishes, seed} <- {graph(), list(one_of(changes)), integer(1, 1_000_000)} do
      world = World.live(made(spec), [{:stop, 3} | wishes], seed)
      assert world.life.phase == :completed
      assert MapSet.new(Map.keys(world.life.stages)) == world.entries
      for id <- world.forgotten, id not in world.alive, do: assert(id not in world.entries)
    end
  end

  property "every output closes once, unless its stage is already gone", numtests: 150 do
    forall spec <- lives() do
      world = live(spec)
      closed = for {:action, {:tell, id, {:finalize, _}}} <- world.log, do: id
      assert closed == Enum.uniq(closed)
      gone = for {:event, {:exited, id, _, _}} <- world.log, do: id
      gone = world.forgotten ++ gone

      if Enum.any?(world.log, &match?({:action, :running}, &1)) do
        assert [] = Map.keys(world.life.stages) -- (closed ++ gone)
      end
    end
  end

  property "nothing closes before its inputs, except to cut a cycle", numtests: 150 do
    forall {spec, seed} <- {graph(), integer(1, 1_000_000)} do
      graph = made(spec)
      world = World.live(graph, [{:stop, 3}], seed)
      order = for {:action, {:tell, id, {:finalize, _}}} <- Enum.reverse(world.log), do: id
      place = order |> Enum.with_index() |> Map.new()

      for {from, to} <- graph.links, straight?(graph, from) do
        assert place[from] < place[to]
      end
    end
  end

  property "a stage closes no later than the pipeline and no earlier than its inputs" do
    forall {spec, seed} <- {graph(), integer(1, 1_000_000)} do
      graph = made(spec)
      world = World.live(graph, [{:stop_at, 150}], seed)
      times = for {:action, {:tell, id, {:finalize, t}}} <- world.log, into: %{}, do: {id, t}

      for {from, to} <- graph.links, straight?(graph, from) do
        assert times[from] <= times[to]
        assert times[to] <= world.life.ending.final
      end
    end
  end

  property "a source is notified of its end after the other stages and before it must close" do
    forall {spec, wishes, seed} <- lives() do
      log = Enum.reverse(live({spec, wishes, seed}).log)

      for {{:event, {:completed, id, time}}, n} <- Enum.with_index(log), is_integer(time) do
        actions = log |> Enum.drop(n + 1) |> Enum.take_while(&match?({:action, _}, &1))
        assert List.last(actions) == {:action, {:tell, id, :heard}}
        refute {:action, {:tell, id, {:finalize, time}}} in actions
      end
    end
  end

  property "each caller that adds something gets one reply" do
    forall spec <- lives() do
      world = live(spec)
      asked = for {:event, {:grow, _, _, from}} <- world.log, do: from
      answered = for {:action, {:reply, {:grower, _} = from, _}} <- world.log, do: from
      assert Enum.sort(answered) == Enum.sort(asked)
      assert world.life.growths == %{}
    end
  end

  property "parts start again: each caller gets one reply, and no stage has two processes",
    numtests: 300 do
    wishes = [
      {:part, list(integer(1, 10))},
      {:start, list(integer(1, 10))},
      {:start, list(one_of([integer(1, 10), integer(100, 104)]))},
      {:remove, list(integer(1, 10))},
      {:grow, :restart},
      {:refuse, integer(1, 10)},
      {:kill, integer(1, 10)},
      {:tap, 1}
    ]

    forall {spec, wishes, seed} <- {graph(), list(one_of(wishes)), integer(1, 1_000_000)} do
      world = World.live(made(spec), wishes ++ [{:stop, 3}], seed)
      assert world.life.phase == :completed
      assert world.life.growths == %{}
      asked = for {:event, {:start_part, _, _, _, from}} <- world.log, do: from
      answered = for {:action, {:reply, {:starter, _} = from, _}} <- world.log, do: from
      assert Enum.sort(answered) == Enum.sort(asked)
    end
  end

  property "each caller that stops a part gets one reply", numtests: 100 do
    forall {spec, parts, seed} <- {graph(), list(list(integer(1, 10))), integer(1, 1_000_000)} do
      world = World.live(made(spec), Enum.map(parts, &{:part, &1}) ++ [{:stop, 3}], seed)
      asked = for {:event, {:stop_part, _, _, %{from: from}}} <- world.log, do: from
      answered = for {:action, {:reply, from, _}} <- world.log, do: from
      assert answered -- asked == []
      # The server replies to callers that are still waiting when the whole pipeline ends.
      left = for {_, %{from: from}} <- world.life.parts, do: from
      assert Enum.sort(answered ++ left) == Enum.sort(asked)
    end
  end

  # A composite of two stages after a source; one of them has ended for a restart.
  defp restarting(pending) do
    alias Situ.Lifecycle.{Links, Member, State}

    member = fn id, how ->
      unit = if id > 1, do: {"Unit", :restart}
      struct!(%Member{id: id, path: "S#{id}", source?: id == 1, up?: true, unit: unit}, how)
    end

    %State{
      phase: :running,
      step: :running,
      stages: %{
        1 => member.(1, []),
        2 => member.(2, status: :restarting, alive?: false),
        3 => member.(3, status: :restarting, alive?: pending)
      },
      links: Links.new(%{1 => link(1, 2), 2 => link(2, 3)})
    }
  end

  defp link(from, to), do: %{from: from, to: to, output: :out, id: from}

  defp apply_events(life, events) do
    Enum.flat_map_reduce(events, life, fn event, life ->
      {life, actions} = Situ.Lifecycle.apply_event(life, event, 9)
      {actions, life}
    end)
  end

  defp exited(id), do: {:exited, id, Situ.Error.new(:component_killed, "S#{id}"), nil}

  test "stages that have ended for a restart close if the pipeline stops before it" do
    {actions, life} = apply_events(restarting(true), [{:stop, 0}, exited(3)])
    assert %{2 => %{status: :dead}, 3 => %{status: :dead}} = life.stages
    refute Enum.any?(actions, &match?({:spawn, _}, &1))
  end

  test "a source that is ending for a restart when the pipeline stops is no failure" do
    life = put_in(restarting(false).stages[2], restarting(true).stages[3])
    life = put_in(life.stages[2].id, 2)
    life = %{life | links: Situ.Lifecycle.Links.new(%{2 => link(2, 3)})}

    {_actions, life} =
      apply_events(life, [{:stop, 0}, {:source_stopped, 1}, exited(2), {:finalized, 1}])

    assert life.errors == []
    assert %{2 => %{status: :dead}, 3 => %{status: :dead}} = life.stages
    assert life.step == :quit
  end

  test "a part that is restarting can be stopped, and does not restart" do
    opts = %{catch_up: 0, from: :caller}

    {actions, life} =
      apply_events(restarting(true), [{:stop_part, :ref, [2, 3], opts}, exited(3)])

    assert {:reply, :caller, :ok} in actions
    refute Enum.any?(actions, &match?({:spawn, _}, &1))
    assert life.parts == %{}
  end

  test "a stage that starts while its part is being stopped gets the closing mark again from its producer" do
    life = put_in(restarting(true).stages[2].status, :running)
    life = put_in(life.stages[2].alive?, true)
    life = put_in(life.stages[2].again?, true)
    life = put_in(life.stages[3].status, :running)
    opts = %{catch_up: 0, from: :caller}
    {actions, life} = apply_events(life, [{:stop_part, :ref, [2, 3], opts}, {:started, 2}])
    assert life.links.closing == %{1 => 9}
    assert [1, 2] = for({:rewire, 2, links} <- actions, {tag, _link} <- links, do: tag)

    # The messages before the mark would be lost if they were sent before the new process is connected.
    assert [{:rewire, 2, _}, {:tell, 1, {:cut, 1, 9}}] =
             Enum.filter(
               actions,
               &(match?({:rewire, _, _}, &1) or match?({:tell, 1, {:cut, _, _}}, &1))
             )
  end

  test "a stage that starts after its producer has ended gets the closing mark" do
    life = put_in(restarting(true).stages[2].status, :running)
    life = put_in(life.stages[2].alive?, true)
    life = put_in(life.stages[2].again?, true)
    life = put_in(life.stages[1].alive?, false)
    life = %{life | links: Situ.Lifecycle.Links.close_link(life.links, 1, 9)}
    {actions, _life} = apply_events(life, [{:started, 2}])
    assert {:tell, 2, {:peer_gone, 1, 9}} in actions
  end

  test "a producer that restarts while a part is being stopped cuts the part off when it has started" do
    life = put_in(restarting(true).stages[1].again?, true)
    life = put_in(life.stages[2].status, :running)
    life = put_in(life.stages[2].alive?, true)
    life = put_in(life.stages[3].status, :running)
    life = put_in(life.stages[3].alive?, true)
    stop = {:stop_part, :ref, [2, 3], %{catch_up: 0, from: :caller}}
    {actions, life} = apply_events(life, [stop])
    refute Enum.any?(actions, &match?({:tell, 1, {:cut, _, _}}, &1))

    {actions, _life} = apply_events(life, [{:started, 1}])
    assert {:tell, 1, {:cut, 1, 9}} in actions

    {actions, _life} = apply_events(life, [{:unsubscribed, 2, 1, 9}])
    assert {:tell, 1, {:untap, 1}} in actions
  end

  # A source and two consumers of its part, all with new processes that have not started.
  defp starting_again do
    again = &%{&1 | status: :running, alive?: true, again?: true}
    life = restarting(true)
    %{life | stages: Map.new(life.stages, fn {id, member} -> {id, again.(member)} end)}
  end

  test "a source that has not started again is asked to stop when it has started" do
    stop = {:stop_part, :ref, [1, 2, 3], %{catch_up: 0, from: :caller}}
    {actions, life} = apply_events(starting_again(), [stop])
    refute Enum.any?(actions, &match?({:tell, 1, {:stop, _}}, &1))
    {actions, _life} = apply_events(life, [{:started, 1}])
    assert {:tell, 1, {:stop, 9}} in actions
  end

  test "consumers that start after a source died before its start get closing marks" do
    stop = {:stop_part, :ref, [1, 2, 3], %{catch_up: 0, from: :caller}}
    {_actions, life} = apply_events(starting_again(), [stop, exited(1)])
    {actions, _life} = apply_events(life, [{:started, 2}])
    assert {:tell, 2, {:peer_gone, 1, 9}} in actions
  end

  test "a pipeline that is stopped does not wait for a source that died while its part was being stopped" do
    life = put_in(starting_again().links, Situ.Lifecycle.Links.new(%{}))
    life = put_in(life.stages[2].source?, true)
    stop_part = {:stop_part, :ref, [1], %{catch_up: 0, from: :caller}}
    {_actions, life} = apply_events(life, [stop_part, {:stop, 1_000}, exited(1), {:settled, 2}])
    {_actions, life} = apply_events(life, [{:source_stopped, 2}])
    assert life.step == :quit
  end

  test "the stages of a part that cannot start do not wait for each other" do
    growth = %{step: :start, pending: MapSet.new([3]), lent: [], from: :caller, again?: true}
    life = %{starting_again() | growths: %{ref: Map.put(growth, :ids, [1, 2, 3])}}
    {actions, life} = apply_events(life, [exited(3)])
    assert life.growths == %{}
    told = for {:tell, 1, request} <- actions, do: request
    assert {:untap, 1} in told
    assert List.last(told) == :quit
  end

  test "a stage that restarts gets the closing mark of a stream that had ended before its part was added" do
    growth = %{step: :lend, pending: MapSet.new([1]), lent: [1], from: :caller, again?: false}
    life = %{starting_again() | growths: %{ref: Map.put(growth, :ids, [2, 3])}}
    {actions, life} = apply_events(life, [{:lent, 1, {:closed, 7}}])
    assert {:tell, 2, {:peer_gone, 1, 7}} in actions
    assert life.links.closing == %{1 => 7}
  end

  # True if the stage is neither on a cycle nor downstream of one, where the cycle may be cut.
  defp straight?(graph, id) do
    next = Enum.group_by(graph.links, &elem(&1, 0), &elem(&1, 1))
    upstream = for {from, _} <- graph.links, leads?(next, [from], id, []), do: from
    Enum.all?([id | upstream], &(not leads?(next, Map.get(next, &1, []), &1, [])))
  end

  defp leads?(_next, [], _to, _seen), do: false
  defp leads?(_next, [to | _], to, _seen), do: true

  defp leads?(next, [id | rest], to, seen) do
    if id in seen,
      do: leads?(next, rest, to, seen),
      else: leads?(next, Map.get(next, id, []) ++ rest, to, [id | seen])
  end
end
