defmodule Situ.Fixture.LifecycleWorld do
  # Simulates the world around `Situ.Lifecycle` without processes: each stage is the set of its pending events.
  # Everything in flight is in one bag, and chance selects the next event. This tries every order that messages
  # between processes might take.
  alias Situ.Lifecycle
  alias Situ.Lifecycle.{Links, Member, State}

  defstruct [
    :life,
    :graph,
    bag: [],
    alive: MapSet.new(),
    log: [],
    seed: nil,
    steps: 0,
    next: 100,
    forgotten: [],
    refusing: [],
    # The stages for which the server has an entry.
    entries: MapSet.new(),
    taps: [],
    clock?: false
  ]

  @doc """
  Simulates a pipeline's life and returns the world when nothing is in flight.

  `graph` is `%{sources: [end], others: [on_error], links: [{from, to}]}`. `wishes` are external events (stops, deaths,
  failures) that occur at random; with `{:refuse, id}`, a stage fails to initialize.
  """
  def live(graph, wishes, seed) do
    members = members(graph)

    links =
      for {{from, to}, tag} <- Enum.with_index(graph.links, 1),
          into: %{},
          do: {tag, %{from: from, to: to, output: :out, id: tag}}

    {refusing, wishes} = Enum.split_with(wishes, &match?({:refuse, _}, &1))

    world = %__MODULE__{
      refusing: for({:refuse, id} <- refusing, do: id),
      life: %State{mode: :unlinked},
      graph: {members, links, graph},
      seed: :rand.seed_s(:exsss, seed),
      bag: Enum.map(wishes, &{:wish, &1})
    }

    world |> apply_event(:start) |> run()
  end

  defp members(%{sources: sources, others: others}) do
    for {kind, id} <-
          Enum.with_index(Enum.map(sources, &{:source, &1}) ++ Enum.map(others, &{:other, &1}), 1),
        into: %{} do
      {source?, on_error} =
        case kind do
          {:source, _} -> {true, :stop}
          {:other, on_error} -> {false, on_error}
        end

      {id, %Member{id: id, path: "S#{id}", source?: source?, on_error: on_error}}
    end
  end

  defp run(%{bag: []} = world), do: world
  defp run(%{steps: 20_000} = world), do: world

  # Timers fire when nothing else is left, or occasionally earlier.
  defp run(world) do
    {n, seed} = :rand.uniform_s(length(world.bag), world.seed)
    {what, bag} = List.pop_at(world.bag, n - 1)
    world = %{world | seed: seed, steps: world.steps + 1}
    idle? = Enum.all?(bag, &timer?/1)

    if timer?(what) and not idle? and rem(world.steps, 7) != 0,
      do: run(world),
      else: run(happen(what, %{world | bag: bag}))
  end

  defp timer?({:timer, _}), do: true
  defp timer?({:watch, _}), do: true
  defp timer?(_), do: false

  # The stage's process ends with this event.
  defp happen({:stage, id, {:init_failed, id, _} = event}, world) do
    if MapSet.member?(world.alive, id),
      do: world |> apply_event(event) |> kill(id),
      else: world
  end

  # Pending events of a stage are void after its process has ended.
  defp happen({:stage, id, event}, world) do
    if MapSet.member?(world.alive, id), do: apply_event(world, event), else: world
  end

  defp happen({:event, event}, world), do: apply_event(world, event)
  defp happen({:timer, event}, world), do: apply_event(world, event)

  defp happen({:watch, which}, world),
    do:
      apply_event(world, {:watched, which, %{moved?: false, idle: world.alive, patient?: false}})

  defp happen({:wish, {:kill, id}}, world), do: kill(world, id)

  defp happen({:wish, {:fail, id}}, world) do
    if MapSet.member?(world.alive, id) and world.life.phase == :running,
      do: apply_event(world, {:failed, id, error(id), 5}),
      else: world
  end

  # Only running stages can form a part.
  defp happen({:wish, {:part, ids}}, world) do
    ids = part(world, ids)
    if ids == [], do: world, else: stop_part(world, ids, [])
  end

  # A removed part may have ended before, completely or partly. An operation waits for others on the same stages.
  defp happen({:wish, {:remove, ids}}, world) do
    busy = growing_ids(world) ++ stopping_ids(world)
    there? = &(&1 in world.entries and &1 not in world.forgotten and &1 not in busy)
    forget = ids |> Enum.uniq() |> Enum.filter(there?)
    if forget == [], do: world, else: stop_part(world, part(world, forget), forget)
  end

  # A part of which no stage is running starts again, now or when it has ended.
  defp happen({:wish, {:start, ids}}, %{life: %{phase: :running}} = world) do
    busy = growing_ids(world) ++ stopping_ids(world)
    there? = &(&1 in world.entries and &1 not in world.forgotten and &1 not in busy)
    ids = ids |> Enum.uniq() |> Enum.filter(there?)
    stopped? = &(world.life.stages[&1].status in [:ended, :dead])

    if ids != [] and Enum.all?(ids, stopped?),
      do: apply_event(world, {:start_part, make_ref(), ids, :fresh, {:starter, make_ref()}}),
      else: world
  end

  defp happen({:wish, {:start, _ids}}, world), do: world

  # Attaches a tap as the server does.
  defp happen({:wish, {:tap, _}}, %{life: %{phase: :running}} = world) do
    case Enum.find(world.life.stages, fn {_, m} -> m.status == :running and not m.tap? end) do
      {from, _} ->
        id = world.next
        link = %{from: from, to: id, output: :out, id: {from, id}}
        world = %{world | next: id + 1, taps: [id | world.taps]}
        world = %{world | entries: MapSet.put(world.entries, id)}
        world = perform({:spawn, [id]}, world)
        member = %Member{id: id, path: "S#{id}", on_error: :skip, tap?: true}
        world |> apply_event({:joined, member}) |> apply_event({:linked, link.id, link})

      nil ->
        world
    end
  end

  defp happen({:wish, {:tap, _}}, world), do: world

  defp happen({:wish, :untap}, %{taps: [id | taps]} = world) do
    world = put(%{world | taps: taps}, {:wish, {:kill, id}})
    if id in world.entries, do: apply_event(world, {:left, id}), else: world
  end

  defp happen({:wish, :untap}, world), do: world

  # Adds a source and a stage after it; the stage also follows a running stage, if there is one.
  defp happen({:wish, {:grow, on_error}}, world) do
    {a, b} = {world.next, world.next + 1}
    # The server accepts the new stages only while it is running.
    fresh = if world.life.phase == :running, do: [a, b], else: []
    world = %{world | next: b + 1, entries: Enum.into(fresh, world.entries)}
    flowing = for {id, %{status: :running, up?: true}} <- world.life.stages, id < a, do: id
    member = %Member{id: a, path: "S#{a}", source?: true, on_error: on_error, added?: true}
    other = %{member | id: b, path: "S#{b}", source?: false}
    inner = %{from: a, to: b, output: :out, id: {a, b}}
    outer = for id <- Enum.take(flowing, 1), do: %{from: id, to: b, output: :out, id: {id, b}}

    plan = %{
      members: %{a => member, b => other},
      links: Map.new([inner | outer], &{&1.id, &1}),
      lent: Enum.map(outer, & &1.id)
    }

    apply_event(world, {:grow, make_ref(), plan, {:grower, a}})
  end

  defp happen({:wish, event}, world), do: apply_event(world, event)

  defp part(%{life: %{phase: :running}} = world, ids) do
    alone = for {_, part} <- world.life.parts, id <- part.ids, do: id
    growing = growing_ids(world)

    for id <- ids,
        %{status: :running} <- [world.life.stages[id]],
        id not in alone and id not in growing,
        do: id
  end

  defp part(_world, _ids), do: []

  defp stopping_ids(world), do: for({_, part} <- world.life.parts, id <- part.ids, do: id)
  defp growing_ids(world), do: for({_, growth} <- world.life.growths, id <- growth.ids, do: id)

  defp stop_part(%{life: %{phase: :running}} = world, ids, forget) do
    opts = %{catch_up: 10, from: {:caller, make_ref()}, forget: forget}
    apply_event(world, {:stop_part, make_ref(), ids, opts})
  end

  defp stop_part(world, _ids, _forget), do: world

  defp kill(world, id) do
    if MapSet.member?(world.alive, id) do
      world = %{world | alive: MapSet.delete(world.alive, id)}
      # Its last messages may still be in flight, followed by the notification of its end.
      world = %{world | bag: Enum.reject(world.bag, &match?({:stage, ^id, _}, &1))}

      world =
        if id in world.entries,
          do: apply_event(world, {:exited, id, error(id), nil}),
          else: world

      if id in world.forgotten, do: apply_event(world, {:left, id}), else: world
    else
      world
    end
  end

  defp first_word(world, id) do
    if id in world.refusing, do: {:init_failed, id, error(id)}, else: {:up, id}
  end

  defp error(id), do: Situ.Error.new(:component_failed, "S#{id} failed")

  defp apply_event(world, event) do
    {life, actions} = Lifecycle.apply_event(world.life, event, 1_000 + world.steps)
    world = %{world | life: life, log: [{:event, event} | world.log]}

    Enum.reduce(actions, world, fn action, world ->
      addressed!(action, world)
      perform(action, %{world | log: [{:action, action} | world.log]})
    end)
  end

  # The server must not act on a stage that it does not have.
  defp addressed!({what, ids}, world) when what in [:spawn, :start, :run, :shutdown, :kill],
    do: known!(what, List.wrap(ids), world)

  defp addressed!({what, id, _}, world) when what in [:tell, :rewire, :restarted],
    do: known!(what, [id], world)

  defp addressed!({:lend, tag}, world) do
    case world.life.links.topology do
      %{^tag => %{from: from, to: to}} -> known!(:lend, [from, to], world)
      _ -> raise "#{inspect(tag)} is lent but is not a connection"
    end
  end

  defp addressed!(_action, _world), do: :ok

  defp known!(what, ids, world) do
    case Enum.reject(ids, &(&1 in world.entries)) do
      [] -> :ok
      gone -> raise "#{what} is for #{inspect(gone)}, which the server has dropped"
    end
  end

  defp perform({:handle, :run}, world), do: put(world, {:event, {:handled, :run, :ok}})
  defp perform({:handle, :completed}, world), do: put(world, {:event, {:handled, :completed}})

  defp perform(:plan, %{graph: {members, links, _}} = world) do
    world = %{world | entries: MapSet.new(Map.keys(members))}
    put(world, {:event, {:planned, members, links}})
  end

  defp perform({:spawn, ids}, world) do
    world = %{world | alive: MapSet.union(world.alive, MapSet.new(ids))}
    Enum.reduce(ids, world, &put(&2, {:stage, &1, first_word(world, &1)}))
  end

  defp perform(:start_clock, world), do: %{world | clock?: true}

  defp perform({:start, _ids}, %{clock?: false}),
    do: raise("stages are wired before there is a clock")

  defp perform({:start, ids}, world),
    do: Enum.reduce(ids, world, &put(&2, {:stage, &1, {:started, &1}}))

  defp perform({:run, ids}, world) do
    {_, _, %{sources: sources}} = world.graph

    for id <- ids,
        %{source?: true} <- [world.life.stages[id]],
        time = if(id < 100, do: Enum.at(sources, id - 1), else: 9),
        reduce: world do
      world -> put(world, {:stage, id, {:completed, id, time}})
    end
  end

  # A stage has one process at a time.
  defp perform({:reset, ref, ids, _how}, world) do
    if running = Enum.find(ids, &(&1 in world.alive)), do: raise("S#{running} is still alive")
    apply_event(world, {:reset, ref, :ok})
  end

  # A closed stream reports that it has closed.
  defp perform({:lend, tag}, world) do
    %{from: from} = world.life.links.topology[tag]
    closed? = not world.life.stages[from].open?
    put(world, {:stage, from, {:lent, tag, if(closed?, do: {:closed, 7}, else: {:open, 5})}})
  end

  defp perform({:forget, ids}, world) do
    over = Enum.filter(ids, &(&1 in world.entries and &1 not in world.alive))
    world = %{world | forgotten: ids ++ world.forgotten}
    Enum.reduce(over, world, &apply_event(&2, {:left, &1}))
  end

  defp perform({:drop, id}, world), do: %{world | entries: MapSet.delete(world.entries, id)}
  defp perform({:tell, id, :settle}, world), do: put(world, {:stage, id, {:settled, id}})

  defp perform({:tell, id, {:stop, _}}, world),
    do: put(world, {:stage, id, {:source_stopped, id}})

  # Closing marks travel to consumers; a consumer that is gone receives none.
  defp perform({:tell, id, {:finalize, time}}, world) do
    if MapSet.member?(world.alive, id) do
      Enum.reduce(Links.list_outgoing(world.life.links, id), world, fn {tag, link}, world ->
        put(world, {:stage, link.to, {:unsubscribed, link.to, tag, time}})
      end)
    else
      world
    end
  end

  defp perform({:tell, _id, {:cut, tag, time}}, world) do
    case world.life.links.active do
      %{^tag => %{to: to}} -> put(world, {:stage, to, {:unsubscribed, to, tag, time}})
      _ -> world
    end
  end

  defp perform({:tell, id, {:peer_gone, tag, time}}, world) do
    case world.life.links.active do
      %{^tag => %{to: ^id}} -> put(world, {:stage, id, {:unsubscribed, id, tag, time}})
      _ -> world
    end
  end

  # A live producer that has closed sends its mark again to a process that replaces a consumer.
  defp perform({:rewire, id, links}, %{life: life} = world) do
    for {tag, %{to: ^id, from: from}} <- links,
        time = life.links.closing[tag],
        match?(%{alive?: true, open?: false, again?: false}, life.stages[from]),
        reduce: world do
      world -> put(world, {:stage, id, {:unsubscribed, id, tag, time}})
    end
  end

  defp perform({:tell, id, :quit}, world), do: put(world, {:wish, {:kill, id}})
  defp perform({:kill, id}, world), do: put(world, {:wish, {:kill, id}})

  defp perform({:measure, :drain}, world),
    do: put(world, {:event, {:measured, :drain, rest(world)}})

  defp perform({:after, _ms, event}, world), do: put(world, {:timer, event})

  # One check is enough, because no stage gets stuck in this world.
  defp perform({:watch, _ms, _which}, world), do: world
  defp perform(_action, world), do: world

  # A cycle comes to rest eventually.
  defp rest(world), do: %{quiet?: rem(world.steps, 3) == 0, mark: world.steps, busy?: false}

  defp put(world, what), do: %{world | bag: [what | world.bag]}
end
