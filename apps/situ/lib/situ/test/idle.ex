defmodule Situ.Test.Idle do
  @moduledoc false
  # Waits, without sleeping, until a pipeline with a manual clock is idle.
  alias Situ.Clock
  alias Situ.Parallel
  alias Situ.Stage.{SharedProcess, State}

  @spec await_idle(pid(), Clock.t()) :: :ok
  def await_idle(pipeline, clock), do: poll_until_idle(pipeline, clock, nil)

  # Each round asks every process once. If it changed nothing and no alarm is due, the pipeline is idle.
  defp poll_until_idle(pipeline, clock, before) do
    case Process.info(pipeline, :links) do
      nil ->
        :ok

      {:links, _links} ->
        now = probe_pipeline(pipeline, Clock.now(clock))
        if now == before and :due not in now, do: :ok, else: poll_until_idle(pipeline, clock, now)
    end
  end

  # Probes the pipeline's process and its stages, and the same for pipelines of branches that run in processes.
  defp probe_pipeline(pipeline, now) do
    case Process.info(pipeline, :links) do
      {:links, links} ->
        stages = for pid <- [pipeline | links], is_pid(pid), pid != self(), do: pid
        Enum.flat_map(stages, &probe_process(&1, now))

      nil ->
        [:ended]
    end
  end

  # The request is queued after all earlier messages, so the reply means that those have been handled.
  defp probe_process(pid, now) do
    state = :sys.get_state(pid)
    [:erlang.phash2(state) | probe_steps(state, now)]
  catch
    :exit, _ended -> [:ended]
  end

  defp probe_steps(%State{} = state, now),
    do: state |> State.list_steps() |> Enum.flat_map(&probe_step(&1, now))

  defp probe_steps(%SharedProcess{members: members}, now),
    do: Enum.flat_map(members, fn {_id, state} -> probe_steps(state, now) end)

  defp probe_steps(_server, _now), do: []

  defp probe_step(%{timers: %{alarm: {due, _wait, _timer}}}, now) when due <= now, do: [:due]

  defp probe_step(%{worker: %{core: %Parallel.Component{} = core}}, now),
    do: Enum.flat_map(Parallel.Component.branch_pipelines(core), &probe_pipeline(&1, now))

  defp probe_step(_step, _now), do: []
end
