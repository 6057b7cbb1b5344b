defmodule Situ.Test.Idle do
  @moduledoc false
  # Waits, without sleeping, until a pipeline with a manual clock is idle.
  alias Situ.Clock
  alias Situ.Clock.Timers
  alias Situ.Parallel
  alias Situ.Ports.Outputs
  alias Situ.Stage.{SharedProcess, State}

  @spec await_idle(pid(), Clock.t()) :: :ok
  def await_idle(pipeline, clock), do: poll_until_idle(pipeline, clock, nil)

  @doc "Returns the next time at which a component of an idle pipeline wakes up, or `nil`."
  @spec next_time(pid()) :: Situ.Time.t() | nil
  def next_time(pipeline) do
    times =
      for {_hash, steps} <- probe_pipeline(pipeline),
          step <- steps,
          time <- [Timers.next_time(step.timers), Outputs.next_time(step.outputs)],
          time != nil,
          do: time

    Enum.min(times, fn -> nil end)
  end

  # Each round asks every process once. If it changed nothing and no alarm is due, the pipeline is idle.
  defp poll_until_idle(pipeline, clock, before) do
    if Process.alive?(pipeline) do
      now = Clock.now(clock)
      probes = for {hash, steps} <- probe_pipeline(pipeline), do: {hash, list_alarms(steps)}
      due? = Enum.any?(probes, fn {_, times} -> Enum.any?(times, &(&1 <= now)) end)

      if probes == before and not due?,
        do: :ok,
        else: poll_until_idle(pipeline, clock, probes)
    else
      :ok
    end
  end

  # Probes the pipeline's process and its stages, and the same for pipelines of branches that run in processes.
  defp probe_pipeline(pipeline) do
    case Process.info(pipeline, :links) do
      {:links, links} ->
        stages = for pid <- [pipeline | links], is_pid(pid), pid != self(), do: pid
        Enum.flat_map(stages, &probe_process/1)

      nil ->
        [{:ended, []}]
    end
  end

  # The request is queued after all earlier messages, so the reply means that those have been handled.
  defp probe_process(pid) do
    state = :sys.get_state(pid)
    steps = list_steps(state)
    [{:erlang.phash2(state), steps} | Enum.flat_map(steps, &probe_branches/1)]
  catch
    :exit, _ended -> [{:ended, []}]
  end

  defp list_steps(%State{} = state), do: State.list_steps(state)

  defp list_steps(%SharedProcess{members: members}),
    do: Enum.flat_map(members, fn {_id, state} -> list_steps(state) end)

  defp list_steps(_server), do: []

  defp probe_branches(%{worker: %{core: %Parallel.Component{} = core}}),
    do: Enum.flat_map(Parallel.Component.branch_pipelines(core), &probe_pipeline/1)

  defp probe_branches(_step), do: []

  defp list_alarms(steps), do: for(%{timers: %{alarm: {due, _wait, _timer}}} <- steps, do: due)
end
