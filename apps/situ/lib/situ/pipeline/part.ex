defmodule Situ.Pipeline.Part do
  @moduledoc false
  # A composite, or one component, that is stopped while the rest of its pipeline runs on: the same steps as at the end of a
  # pipeline, for some of its stages. Their inputs from outside close and their sources stop at the time of the stop, their
  # outputs close in order, and they quit. The parts that are being stopped are in the server's state, under a reference each.
  alias Situ.{Error, Options}
  alias Situ.Graph.Vertex
  alias Situ.Stage.Counters
  alias Situ.Pipeline.{Crew, Death, Ending, Finalizer, Launch, Life, Notice, Watch}

  @typedoc "`ids`: its stages, `pending`: its sources that have yet to stop, `error`: what went wrong meanwhile."
  @type t :: %{
          ids: MapSet.t(pos_integer()),
          pending: MapSet.t(pos_integer()),
          final: Situ.Time.t(),
          from: GenServer.from() | nil,
          error: Error.t() | nil
        }

  @doc "Begins; the caller is answered when all of it has closed, or at once when it cannot be."
  @spec stop(Life.t(), String.t(), non_neg_integer(), GenServer.from() | nil) ::
          {:ok | {:error, Error.t()}, Life.t()}
  def stop(%{phase: :running} = state, path, catch_up, from) do
    case stages(state, path) do
      {:ok, stages} -> {:ok, begin(state, stages, catch_up, from)}
      {:error, error} -> {{:error, error}, state}
    end
  end

  def stop(state, _path, _catch_up, _from), do: {{:error, Launch.not_running()}, state}

  @doc "Something happened: goes on where nothing is waited for any more."
  @spec next(Life.t()) :: Life.t()
  def next(%{phase: :running, parts: parts} = state) when parts != %{},
    do: Enum.reduce(Map.keys(parts), state, &step/2)

  def next(state), do: state

  @doc "A source has posted its last message."
  @spec stopped(Life.t(), pos_integer()) :: Life.t()
  def stopped(%{parts: parts} = state, id) do
    parts = Map.new(parts, fn {ref, p} -> {ref, %{p | pending: MapSet.delete(p.pending, id)}} end)
    %{state | parts: parts}
  end

  @doc "The part that a stage is stopped with."
  @spec of(Life.t(), pos_integer()) :: reference() | nil
  def of(state, id),
    do: Enum.find_value(state.parts, fn {ref, part} -> if id in part.ids, do: ref end)

  @doc "A stage died while it was stopped with others: they go on without it."
  @spec died(Life.t(), reference(), pos_integer(), Error.t()) :: Life.t()
  def died(state, ref, id, error) do
    state = Notice.noted(state |> Death.dead(id) |> stopped(id), error)
    part = state.parts[ref]
    next(%{state | parts: %{state.parts | ref => %{part | error: part.error || error}}})
  end

  @doc "Sources that lag behind the clock end where they are."
  @spec enough(Life.t(), reference()) :: Life.t()
  def enough(state, ref) do
    with %{^ref => part} <- state.parts do
      for id <- part.pending, do: send(state.stages[id].pid, {:situ, :stop_now})
    end

    state
  end

  @doc "Nothing has moved for the stop timeout: what is in the middle of something is killed."
  @spec stuck(Life.t(), reference(), term()) :: Life.t()
  def stuck(%{phase: :running} = state, ref, mark) when is_map_key(state.parts, ref) do
    if fingerprint(state, ref) == mark do
      for id <- state.parts[ref].ids, stage = state.stages[id], not Watch.idle?(stage) do
        Process.exit(stage.pid, :kill)
      end
    end

    watch(state, ref)
    state
  end

  def stuck(state, _ref, _mark), do: state

  # What is to be stopped

  defp stages(state, path) do
    inside = Enum.filter(state.stages, fn {_, s} -> Enum.any?(s.vertices, &within?(&1, path)) end)
    running = for {_, %{state: :running} = stage} <- inside, of(state, stage.id) == nil, do: stage

    cond do
      inside == [] -> {:error, unknown(state, path)}
      running == [] -> {:error, ended(path)}
      true -> whole(running, path)
    end
  end

  defp within?(vertex, path),
    do: vertex.path == path or String.starts_with?(vertex.path, path <> ".")

  defp whole(stages, path) do
    case Enum.find(stages, fn s -> not Enum.all?(s.vertices, &within?(&1, path)) end) do
      nil -> {:ok, stages}
      stage -> {:error, shared(stage, path)}
    end
  end

  # Stopping it

  defp begin(state, stages, catch_up, from) do
    final = Life.now(state)
    ids = MapSet.new(stages, & &1.id)
    sources = for %{vertices: [head | _]} = stage <- stages, Vertex.source?(head), do: stage
    for stage <- stages, do: :atomics.put(stage.control, 1, final)

    for {tag, link} <- state.active, link.to in ids, link.from not in ids do
      send(state.stages[link.from].pid, {:situ, {:cut, tag, final}})
    end

    for source <- sources, do: send(source.pid, {:situ, {:stop, final}})
    ref = make_ref()
    Process.send_after(self(), {:situ_part_enough, ref}, catch_up)

    part = %{
      ids: ids,
      pending: MapSet.new(sources, & &1.id),
      final: final,
      from: from,
      error: nil
    }

    completable = MapSet.difference(state.completable, ids)
    state = %{state | parts: Map.put(state.parts, ref, part), completable: completable}
    watch(state, ref)
    next(state)
  end

  defp watch(state, ref) do
    mark = fingerprint(state, ref)
    Process.send_after(self(), {:situ_part_stuck, ref, mark}, state.settings.stop_timeout)
  end

  # Something else as soon as anything in it has moved; what goes on outside is no progress of it.
  defp fingerprint(state, ref) do
    part = state.parts[ref]
    left = Enum.count(state.order, &(&1 in part.ids))
    links = for {tag, link} <- state.active, link.to in part.ids, do: tag
    {MapSet.size(part.pending), left, Enum.map(links, &Counters.flow(state.counters[&1]))}
  end

  defp step(ref, state) do
    part = state.parts[ref]
    order = Enum.filter(state.order, &(&1 in part.ids))
    active = for {_, link} <- state.active, link.to in part.ids, do: link

    if MapSet.size(part.pending) > 0 do
      state
    else
      case Finalizer.next(order, active) do
        {how, ids} when how in [:close, :break] -> step(ref, Ending.close(state, ids, part.final))
        :wait -> state
        :done -> quit(state, ref, part)
      end
    end
  end

  defp quit(state, ref, part) do
    for id <- part.ids, do: send(state.stages[id].pid, {:situ, :quit})

    if part.from,
      do: GenServer.reply(part.from, if(part.error, do: {:error, part.error}, else: :ok))

    state = Crew.mark(%{state | parts: Map.delete(state.parts, ref)}, part.ids, :ended)
    had = Enum.any?(part.ids, &Vertex.source?(hd(state.stages[&1].vertices)))
    if had, do: Life.without(state), else: state
  end

  defp unknown(state, path) do
    near = Options.nearest(path, Map.keys(state.graph.scopes) ++ Map.keys(state.graph.paths))

    Error.new(:unknown_component, "no composite or component #{inspect(path)}",
      fix: near && "did you mean #{inspect(near)}?"
    )
  end

  defp ended(path), do: Error.new(:not_running, "#{path} has ended, or is being stopped")

  defp shared(stage, path) do
    {inside, outside} = Enum.split_with(stage.vertices, &within?(&1, path))

    Error.new(
      :shared_process,
      "#{hd(inside).path} runs in one process with #{hd(outside).path}, which is not of #{path}",
      why: "a process ends as a whole",
      fix: "give the later of the two async: true, or no synchronous policy",
      meta: %{component: path}
    )
  end
end
