defmodule Situ.Cluster.Runner do
  @moduledoc false
  # Runs one part on one node while this node has the lease, and is on standby otherwise.
  #
  #   standby   looks at the lease
  #   running   has a publisher, a keeper of the lease and a pipeline; takes checkpoints regularly
  #   done      the part has ended; its streams are still served while this node has the lease
  #   failed    a component failed; no node runs the part again
  use GenServer, restart: :transient

  alias Situ.Cluster.{
    PartStarter,
    Deployment,
    Lease,
    Member,
    PartProcesses,
    Plan,
    Publisher,
    SignedEntry,
    Standby
  }

  alias Situ.{Error, Pipeline}
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry
  require Logger

  defstruct [
    :log,
    :deployment,
    :part,
    :plan,
    :agent,
    :epoch,
    :publisher,
    :keeper,
    :pipeline,
    :monitor,
    :error,
    :standby,
    phase: :standby,
    checkpoints: %{taken: 0, refused: nil, possible?: true}
  ]

  @spec start_link(map()) :: GenServer.on_start()
  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @doc "Returns the part's state, for display."
  @spec part_info(pid(), timeout()) :: map()
  def part_info(runner, timeout \\ 30_000), do: GenServer.call(runner, :info, timeout)

  @doc "Stops the sources of the part; messages already posted are still handled."
  @spec stop_sources(pid()) :: :ok
  def stop_sources(runner), do: GenServer.cast(runner, :stop)

  @doc """
  Releases the part: takes a checkpoint, then makes the lease available to other nodes. `demotion` is the demotion
  level of this node from then on: 0 for none; of two drained nodes, the one with the higher level waits longer. With
  a process `mover`, the level applies only while that process is alive, and the previous one is then restored.
  """
  @spec release_part(pid(), non_neg_integer(), pid() | nil) :: :ok
  def release_part(runner, demotion, mover \\ nil),
    do: GenServer.call(runner, {:release, demotion, mover}, :infinity)

  @doc "Sets the demotion level of this node for the part. A part that is already running here stays here."
  @spec set_demotion(pid(), non_neg_integer(), pid() | nil) :: :ok
  def set_demotion(runner, demotion, mover \\ nil),
    do: GenServer.call(runner, {:demote, demotion, mover}, :infinity)

  @doc "Ends a runner permanently: its supervisor does not restart it."
  @spec dismiss(pid()) :: :ok
  def dismiss(runner), do: GenServer.cast(runner, :dismiss)

  @doc "Restarts the part on the same node, from a new checkpoint; does nothing if another node runs it."
  @spec restart_part(pid()) :: :ok | {:error, Error.t()}
  def restart_part(runner), do: GenServer.call(runner, :restart, :infinity)

  @doc "Reports to the runner that a node went down."
  @spec report_node_down(pid(), node()) :: :ok
  def report_node_down(runner, node), do: GenServer.cast(runner, {:down, node})

  @impl true
  def init(args) do
    Process.flag(:trap_exit, true)
    standby = Standby.new(args.deployment.lease)
    state = struct!(__MODULE__, Map.put(args, :standby, standby))
    # The supervisor may have restarted this runner, so the agent needs the new process.
    Member.announce_runner(state.agent, {state.deployment.name, state.part}, self())
    send(self(), :check)
    {:ok, state}
  end

  # The following functions handle the standby phase.

  @impl true
  def handle_info(:check, %{phase: :standby} = state) do
    case Standby.note_node_renewal(state.standby) do
      {true, standby} -> {:noreply, %{state | standby: Standby.schedule_late_check(standby)}}
      {false, standby} -> {:noreply, check_lease(%{state | standby: standby})}
    end
  end

  def handle_info(:check, state), do: {:noreply, state}

  # The owner has written its lease.
  def handle_info({:situ_lease, seq, owner}, %{phase: :standby} = state) when is_integer(seq),
    do: {:noreply, %{state | standby: Standby.note_renewal(state.standby, seq, owner)}}

  def handle_info({:situ_lease, :free, _owner}, %{phase: :standby} = state),
    do: {:noreply, %{state | standby: Standby.note_release(state.standby)}}

  # Another node has acquired the lease after this one.
  def handle_info({:situ_lease, seq, _owner}, %{phase: phase, epoch: epoch} = state)
      when phase in [:running, :done] and is_integer(seq) and seq > epoch,
      do: {:noreply, step_down(state, {:shutdown, :lease_lost})}

  def handle_info(:checkpoint, %{phase: :running} = state) do
    Process.send_after(self(), :checkpoint, div(state.deployment.checkpoint, 1_000_000))
    {:noreply, take_checkpoint(state)}
  end

  def handle_info(:situ_full, %{phase: :running} = state), do: {:noreply, take_checkpoint(state)}

  def handle_info({:DOWN, ref, :process, pid, _}, %{monitor: ref, phase: :running} = state) do
    case Pipeline.await(pid, 5_000) do
      {:ok, _report} ->
        {:noreply, finish_part(state)}

      {:error, error} ->
        {:noreply, if(publisher_ended?(state), do: state, else: fail_part(state, error))}
    end
  end

  # The process that moved the part has ended, successfully or not.
  def handle_info({:DOWN, ref, :process, _, _}, state),
    do: {:noreply, %{state | standby: Standby.restore_demotion(state.standby, ref)}}

  def handle_info({:EXIT, pid, reason}, %{publisher: pid} = state),
    do: {:noreply, step_down(state, reason)}

  def handle_info({:EXIT, pid, reason}, %{keeper: pid} = state),
    do: {:noreply, step_down(state, reason)}

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def handle_cast({:down, node}, %{phase: :standby} = state),
    do: {:noreply, %{state | standby: Standby.note_node_down(state.standby, node)}}

  def handle_cast({:down, _node}, state), do: {:noreply, state}

  def handle_cast(:dismiss, state), do: {:stop, {:shutdown, :forgotten}, state}

  def handle_cast(:stop, %{phase: :running, pipeline: p, plan: plan} = state) do
    if Plan.incoming_streams(plan, state.part) == [], do: Task.start(fn -> Pipeline.stop(p) end)
    {:noreply, state}
  end

  def handle_cast(:stop, state), do: {:noreply, state}

  @impl true
  def handle_call(:info, _from, state) do
    {:reply,
     %{
       part: state.part,
       phase: state.phase,
       epoch: state.epoch,
       owner: owner_name(state),
       demotion: state.standby.demotion,
       error: state.error,
       checkpoints: state.checkpoints,
       publisher: PartProcesses.publisher_info(state.publisher),
       pipeline: if(state.phase == :running, do: state.pipeline)
     }, state}
  end

  def handle_call({:release, demotion, mover}, _from, %{phase: phase} = state)
      when phase in [:running, :done] do
    state = if phase == :running, do: take_checkpoint(state), else: state
    {:reply, :ok, release_and_wait(put_demotion(state, demotion, mover))}
  end

  def handle_call({kind, demotion, mover}, _from, state) when kind in [:release, :demote],
    do: {:reply, :ok, put_demotion(state, demotion, mover)}

  # The code is new, but the plan is the same. A part that does not start with the new code goes to standby, and is
  # taken again once the old code is back.
  def handle_call(:restart, _from, %{phase: :running} = state) do
    state = state |> take_checkpoint() |> release_and_wait()

    with {:ok, reading} <- read_lease(state),
         {:ok, epoch} <- take_lease(state, reading) do
      case start_owning(%{state | epoch: epoch}, &{:refused, &1, &2}) do
        {:refused, state, error} -> {:reply, {:error, error}, release_and_wait(state)}
        state -> {:reply, :ok, state}
      end
    else
      # Another node was faster and has the part now.
      _ -> {:reply, :ok, state}
    end
  end

  def handle_call(:restart, _from, state), do: {:reply, :ok, state}

  defp put_demotion(state, demotion, mover),
    do: %{state | standby: Standby.set_demotion(state.standby, demotion, mover)}

  # A component fails when it can no longer publish; the exit of the publisher gives the reason.
  defp publisher_ended?(%{publisher: publisher}), do: not Process.alive?(publisher)

  defp check_lease(%{standby: standby} = state) do
    with rank when rank != nil <- Member.own_rank(part_rule(state), state.part),
         {:ok, reading} <- read_lease(state),
         {:take, standby} <- Standby.judge_reading(standby, reading, rank),
         {:ok, epoch} <- take_lease(state, reading) do
      log_takeover(state, elem(reading, 1))
      start_owning(%{state | standby: standby, epoch: epoch})
    else
      {:wait, standby} -> %{state | standby: Standby.schedule_next_check(standby)}
      _ -> %{state | standby: Standby.schedule_next_check(standby)}
    end
  end

  defp read_lease(state),
    do: Lease.read_lease(state.log, log_key(state, "lease"), Standby.max_age(state.standby))

  # The following functions handle the phase in which this node has the lease.

  defp start_owning(state, on_failure \\ &fail_part/2) do
    args = %{
      log: state.log,
      deployment: state.deployment.name,
      part: state.part,
      epoch: state.epoch,
      mode: publish_mode(state),
      retain: state.deployment.retain,
      runner: self(),
      streams: Plan.outgoing_streams(state.plan, state.part)
    }

    case Publisher.start_link(args) do
      {:ok, publisher} ->
        state =
          PartProcesses.start_keeper(%{state | publisher: publisher}, log_key(state, "lease"))

        Member.announce_publisher(
          state.agent,
          {state.deployment.name, state.part},
          state.epoch,
          publisher
        )

        run_part(state, Publisher.saved_memories(publisher), on_failure)

      {:error, reason} ->
        handle_refusal(state, reason)
    end
  end

  # The seal of a refused entry remains invalid, so another attempt would fail as well.
  defp handle_refusal(state, {:shutdown, %Error{} = error} = reason),
    do:
      if(SignedEntry.refusal?(error), do: fail_part(state, error), else: stand_by(state, reason))

  defp handle_refusal(state, reason), do: stand_by(state, reason)

  defp stand_by(state, reason) do
    Logger.warning("#{part_name(state)}: takeover failed: #{explain_reason(reason)}")
    {:ok, _} = Lease.release_later(state.log, log_key(state, "lease"), state.epoch)
    %{state | epoch: nil, standby: Standby.resume_after_loss(state.standby)}
  end

  defp take_lease(state, reading),
    do: Lease.acquire(state.log, log_key(state, "lease"), elem(reading, 0), state.standby.ms)

  defp log_takeover(state, owner) do
    if owner not in [nil, "", Atom.to_string(node())],
      do: Logger.warning("#{part_name(state)} continues here: #{owner} is no longer responding")
  end

  # The previous node may have been lost after its last checkpoint and before it wrote the final state.
  defp run_part(state, :done, _failed) do
    write_state(state, %{"State" => "done"}, "")
    %{state | phase: :done}
  end

  defp run_part(state, memories, on_failure) do
    case PartStarter.start_part(state.deployment, state.plan, state.part, %{
           agent: state.agent,
           publisher: state.publisher,
           memories: memories || %{}
         }) do
      {:ok, pipeline} ->
        Process.send_after(self(), :checkpoint, div(state.deployment.checkpoint, 1_000_000))
        monitor = Process.monitor(pipeline)
        %{state | phase: :running, pipeline: pipeline, monitor: monitor}

      {:error, error} ->
        on_failure.(state, error)
    end
  end

  # A part with components that cannot be carried over restarts from its inputs, so no more checkpoints are attempted.
  defp take_checkpoint(%{checkpoints: %{possible?: false}} = state), do: state

  defp take_checkpoint(state) do
    case Pipeline.checkpoint(state.pipeline, &begin_checkpoint(state, &1)) do
      {:ok, memories} ->
        :ok = Publisher.commit_checkpoint(state.publisher, memories)
        count = state.checkpoints.taken + 1
        %{state | checkpoints: %{state.checkpoints | taken: count, refused: nil}}

      {:error, %Error{code: :no_snapshot} = error} ->
        if publish_mode(state) == :outbox and Plan.outgoing_streams(state.plan, state.part) != [],
          do: fail_part(state, undeclared_error(state, error)),
          else: note_refusal(put_in(state.checkpoints.possible?, false), error)

      {:error, error} ->
        note_refusal(state, error)
    end
  catch
    # The publisher has ended, and its exit message is in the mailbox.
    :exit, _ -> state
  end

  defp begin_checkpoint(state, memories) do
    :ok = Publisher.begin_checkpoint(state.publisher)
    memories
  end

  defp note_refusal(state, error),
    do: %{state | checkpoints: %{state.checkpoints | refused: error}}

  defp undeclared_error(state, error) do
    Error.new(:no_snapshot, "part #{state.part} cannot be carried over: #{error.what}",
      why: "the outputs of a part are stored with its checkpoints, unless it is deterministic",
      fix: "#{error.fix}; or declare the part deterministic: true",
      meta: error.meta
    )
  end

  defp finish_part(state) do
    :ok = Publisher.commit_checkpoint(state.publisher, :done)
    write_state(state, %{"State" => "done"}, "")
    %{state | phase: :done, pipeline: nil, monitor: nil}
  catch
    :exit, _ -> state
  end

  defp fail_part(state, error) do
    Logger.error("#{part_name(state)} failed: #{Exception.message(error)}")
    if state.pipeline, do: Process.exit(state.pipeline, :kill)
    write_state(state, %{"State" => "failed"}, Exception.message(error))
    %{state | phase: :failed, pipeline: nil, monitor: nil, error: error}
  end

  # Processes that wait for the deployment to end poll this key.
  defp write_state(state, head, data) do
    subject = {:key, log_key(state, "state")}

    with {:ok, last} <- Log.fetch_last(state.log, subject) do
      head = Map.put(head, "Epoch", Integer.to_string(state.epoch))
      op = "state.#{state.epoch}.#{head["State"]}"
      seq = if last, do: last.seq, else: 0
      Log.append(state.log, subject, seq, %Entry{op: op, head: head, data: data})
    end
  end

  # Either another node has the part, or this node could not renew its lease.
  defp step_down(%{phase: :failed} = state, _reason), do: %{state | publisher: nil, keeper: nil}

  defp step_down(state, reason) do
    Logger.warning("#{part_name(state)} continues on another node: #{explain_reason(reason)}")
    {:ok, _} = Lease.release_later(state.log, log_key(state, "lease"), state.epoch)
    %{PartProcesses.kill_all(state) | standby: Standby.resume_after_loss(state.standby)}
  end

  defp release_and_wait(state),
    do: %{PartProcesses.release_part(state) | standby: Standby.restart_wait(state.standby)}

  defp part_rule(state), do: state.plan.parts[state.part].rule
  defp publish_mode(state), do: if(part_rule(state).deterministic, do: :replay, else: :outbox)
  defp owner_name(%{phase: :standby} = state), do: state.standby.lease.owner
  defp owner_name(_state), do: Atom.to_string(node())
  defp part_name(state), do: "#{state.deployment.name}/#{state.part} on #{node()}"
  defp explain_reason({:shutdown, %Error{} = error}), do: Exception.message(error)
  defp explain_reason({:shutdown, :lease_lost}), do: "this node could not renew its lease in time"
  defp explain_reason(reason), do: inspect(reason, limit: 8)

  @doc "Returns the log key of one `kind` of entry of a part."
  @spec log_key(Deployment.t(), String.t(), String.t()) :: String.t()
  def log_key(deployment, part, kind), do: "#{kind}.#{deployment.name}.#{part}"
  defp log_key(state, kind), do: log_key(state.deployment, state.part, kind)

  @impl true
  def terminate(_reason, state) do
    PartProcesses.kill_all(state)
    # The node may continue to renew its lease for other parts.
    if state.epoch, do: Lease.release(state.log, log_key(state, "lease"), state.epoch)
    :ok
  end
end
