defmodule Situ.Cluster.PartProcesses do
  @moduledoc false
  # Starts and ends the processes of a part that this node runs: the keeper of its lease, its publisher and its
  # pipeline. All functions on a state take the state of the part's runner (`Situ.Cluster.Runner`), and return it.
  alias Situ.Cluster.{Lease, Member, Publisher}
  alias Situ.Pipeline

  @doc "Starts the process that keeps the lease, which is stored under `key`."
  @spec start_keeper(map(), String.t()) :: map()
  def start_keeper(state, key) do
    %{log: log, epoch: epoch, publisher: publisher, standby: %{ms: ms}} = state
    part = {state.deployment.name, state.part}
    on_change = &Member.report_lease(part, &1)

    {:ok, keeper} =
      Task.start_link(fn -> Lease.keep_renewing(log, key, epoch, ms, {publisher, on_change}) end)

    %{state | keeper: keeper}
  end

  @doc "Returns the state of the publisher for display, or `nil` if there is none."
  @spec publisher_info(pid() | nil) :: map() | nil
  def publisher_info(nil), do: nil

  def publisher_info(publisher) do
    Publisher.stream_info(publisher)
  catch
    # The publisher is ending; its exit message follows.
    :exit, _ -> nil
  end

  @doc """
  Releases the lease and ends the processes. Nothing is in flight any more: the part is paused after its last
  checkpoint, or another node will produce its later outputs again.
  """
  @spec release_part(map()) :: map()
  def release_part(state) do
    if state.pipeline, do: Pipeline.abandon(state.pipeline)
    send(state.keeper, {:release, self()})

    receive do
      :released -> :ok
    after
      state.standby.ms -> :ok
    end

    kill_all(state)
  end

  @doc "Kills the processes, and returns the state of a node that does not run the part."
  @spec kill_all(map()) :: map()
  def kill_all(state) do
    for pid <- [state.keeper, state.publisher, state.pipeline], pid != nil do
      Process.unlink(pid)
      Process.exit(pid, :kill)
    end

    if state.monitor, do: Process.demonitor(state.monitor, [:flush])

    %{
      state
      | phase: :standby,
        keeper: nil,
        publisher: nil,
        pipeline: nil,
        monitor: nil,
        epoch: nil
    }
  end
end
