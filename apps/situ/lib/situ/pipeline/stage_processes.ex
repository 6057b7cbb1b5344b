defmodule Situ.Pipeline.StageProcesses do
  @moduledoc false
  # The processes of a pipeline's stages: spawns them, alone or in groups, and knows which stages each contains.
  alias Situ.Pipeline.State
  alias Situ.{Runtime, Stage}
  alias Situ.Stage.SharedProcess

  @doc "Spawns a process for each stage or group of stages, for the first time or again."
  @spec spawn_stages(State.t(), [pos_integer()]) :: State.t()
  def spawn_stages(state, ids) do
    ids
    |> Enum.group_by(&(state.stages[&1].group || {:alone, &1}))
    |> Enum.reduce(state, fn {_group, ids}, state -> spawn_process(state, Enum.sort(ids)) end)
  end

  defp spawn_process(state, ids) do
    pid =
      case Enum.map(ids, &stage_arguments(state, state.stages[&1])) do
        [arguments] -> Stage.spawn_link(arguments)
        arguments -> SharedProcess.spawn_link(arguments)
      end

    # Only this start uses the snapshot; a later restart begins afresh, as its `on_error` specifies.
    shared? = match?([_, _ | _], ids)
    entry = %{pid: pid, shared?: shared?, left: nil, memory: nil, stopped: %{}}

    stages =
      Enum.reduce(ids, state.stages, fn id, all -> Map.update!(all, id, &Map.merge(&1, entry)) end)

    %{state | stages: stages, pids: Map.put(state.pids, pid, ids)}
  end

  defp stage_arguments(state, stage) do
    %{
      marks: stage.marks,
      memory: resumed_memory(state, stage),
      id: stage.id,
      server: self(),
      pipeline: state.settings.name,
      handle: state.handle,
      vertices: stage.vertices,
      tally: stage.tally,
      tail_counters: stage.tail,
      sizes: state.settings.message_sizes
    }
  end

  defp resumed_memory(%{life: %{phase: :starting}} = state, %{vertices: [head | _]}),
    do: state.settings.resume[head.path]

  defp resumed_memory(_state, stage), do: stage.memory

  @doc "Gives a stage that leaves a shared process its own process (see Situ.Stage.Relocation)."
  @spec relocate_stage(State.t(), pos_integer(), Stage.State.t()) :: State.t()
  def relocate_stage(state, id, stage) do
    %{pid: shared} = entry = state.stages[id]
    pid = Stage.spawn_relocated(stage, shared)
    state = remove_stage(state, id)
    send(shared, {:situ, {:relocated, id, pid}})

    %{
      state
      | stages:
          Map.put(state.stages, id, Map.merge(entry, %{pid: pid, shared?: false, left: shared})),
        pids: Map.put(state.pids, pid, [id])
    }
  end

  @doc "Returns whether the process of a stage has ended."
  @spec process_ended?(State.t(), pos_integer()) :: boolean()
  def process_ended?(state, id) do
    case state.stages do
      %{^id => %{pid: pid}} -> id not in Map.get(state.pids, pid, [])
      _ -> false
    end
  end

  @doc "Removes a stage from its process, which may continue with other stages."
  @spec remove_stage(State.t(), pos_integer()) :: State.t()
  def remove_stage(%{pids: pids} = state, id) do
    with %{^id => %{pid: pid}} <- state.stages, %{^pid => ids} <- pids do
      case List.delete(ids, id) do
        [] -> %{state | pids: Map.delete(pids, pid)}
        ids -> %{state | pids: %{pids | pid => ids}}
      end
    else
      _dropped_or_ended -> state
    end
  end

  @doc "Returns the stages that wait for a message and have none."
  @spec idle_stages(State.t()) :: MapSet.t(pos_integer())
  def idle_stages(state),
    do: for({id, stage} <- state.stages, stage_idle?(stage), into: MapSet.new(), do: id)

  defp stage_idle?(%{pid: nil}), do: true

  defp stage_idle?(stage) do
    case Process.info(stage.pid, [:message_queue_len, :current_function]) do
      [message_queue_len: 0, current_function: {module, _, _}] -> module == Runtime.loop_module()
      nil -> true
      _ -> false
    end
  end

  @doc "Returns the stages in the form of `Supervisor.which_children/1`."
  @spec list_children(State.t()) :: [{String.t(), pid() | :undefined, :worker, [module()]}]
  def list_children(state) do
    for {id, %{vertices: [head | _], pid: pid}} <- Enum.sort(state.stages) do
      alive? = state.life.stages[id].alive? and pid != nil
      module = if head.module == :operator, do: Stage, else: head.module
      {head.path, if(alive?, do: pid, else: :undefined), :worker, [module]}
    end
  end
end
