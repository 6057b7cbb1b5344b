defmodule Situ.Cluster.Runner do
  @moduledoc false
  # One part on one node: stands by, runs it while this node has the lease, stands by again.
  #
  #   standby   looks at the lease
  #   running   publisher, keeper of the lease, pipeline; a checkpoint now and then
  #   done      the part has ended; its streams are still served, while this node has the lease
  #   failed    a component failed; nobody runs it again
  use GenServer, restart: :transient

  alias Situ.Cluster.{Assembly, Deployment, Lease, Member, Plan, Publisher}
  alias Situ.{Error, Pipeline}
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry
  require Logger

  # Of nodes: so many go before one that was drained.
  @behind 10

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
    phase: :standby,
    lease: %Lease{},
    checkpoints: %{taken: 0, refused: nil, possible?: true},
    away: 0
  ]

  @spec start_link(map()) :: GenServer.on_start()
  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @doc "The part's state, for people."
  @spec info(pid(), timeout()) :: map()
  def info(runner, timeout \\ 30_000), do: GenServer.call(runner, :info, timeout)

  @doc "Stops the sources of the part; their posted messages are still handled."
  @spec stop(pid()) :: :ok
  def stop(runner), do: GenServer.cast(runner, :stop)

  @doc """
  Gives the part away: a checkpoint, then the lease is free for the others. `away` is how far this node stands behind
  them from then on: 0 not at all; of two drained ones the later one waits longer.
  """
  @spec release(pid(), non_neg_integer()) :: :ok
  def release(runner, away), do: GenServer.call(runner, {:release, away}, :infinity)

  @doc "How far it stands behind from now on; what it has it keeps."
  @spec stand(pid(), non_neg_integer()) :: :ok
  def stand(runner, away), do: GenServer.call(runner, {:stand, away}, :infinity)

  @doc "Starts the part again where it is, from a checkpoint; with nothing to do where another node has it."
  @spec restart(pid()) :: :ok | {:error, Error.t()}
  def restart(runner), do: GenServer.call(runner, :restart, :infinity)

  @doc "A node went down."
  @spec down(pid(), node()) :: :ok
  def down(runner, node), do: GenServer.cast(runner, {:down, node})

  @impl true
  def init(args) do
    Process.flag(:trap_exit, true)
    state = struct!(__MODULE__, args)
    # Its supervisor may have started it again.
    Member.runs(state.agent, {state.deployment.name, state.part}, self())
    send(self(), :look)
    {:ok, state}
  end

  # Standing by

  @impl true
  def handle_info(:look, %{phase: :standby} = state) do
    with rank when rank != nil <- rank(state),
         {:ok, look} <- Lease.look(state.log, key(state, "lease")),
         times = %{lease: lease_ms(state), poll: poll_ms(state), wait: wait_ms(state, rank)},
         {:take, lease} <- Lease.observe(state.lease, look, times),
         {:ok, epoch} <-
           Lease.take(state.log, key(state, "lease"), elem(look, 0), lease_ms(state)) do
      {:noreply, own(%{state | lease: lease, epoch: epoch})}
    else
      {:wait, lease} -> {:noreply, look_again(%{state | lease: lease})}
      _ -> {:noreply, look_again(state)}
    end
  end

  def handle_info(:look, state), do: {:noreply, state}

  def handle_info(:checkpoint, %{phase: :running} = state) do
    Process.send_after(self(), :checkpoint, div(state.deployment.checkpoint, 1_000_000))
    {:noreply, checkpoint(state)}
  end

  def handle_info(:situ_full, %{phase: :running} = state), do: {:noreply, checkpoint(state)}

  def handle_info({:DOWN, ref, :process, pid, _}, %{monitor: ref, phase: :running} = state) do
    case Pipeline.await(pid, 5_000) do
      {:ok, _report} -> {:noreply, ended(state)}
      {:error, error} -> {:noreply, if(left?(state), do: state, else: failed(state, error))}
    end
  end

  def handle_info({:EXIT, pid, reason}, %{publisher: pid} = state),
    do: {:noreply, step_down(state, reason)}

  def handle_info({:EXIT, pid, reason}, %{keeper: pid} = state),
    do: {:noreply, step_down(state, reason)}

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def handle_cast({:down, node}, state) do
    state = %{state | lease: Lease.down(state.lease, node)}
    if state.phase == :standby and state.lease.gone, do: send(self(), :look)
    {:noreply, state}
  end

  def handle_cast(:stop, %{phase: :running, pipeline: p, plan: plan} = state) do
    if Plan.inlets(plan, state.part) == [], do: Task.start(fn -> Pipeline.stop(p) end)
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
       owner: owner(state),
       away: state.away,
       error: state.error,
       checkpoints: state.checkpoints,
       publisher: published(state.publisher),
       pipeline: if(state.phase == :running, do: state.pipeline)
     }, state}
  end

  def handle_call({:release, away}, _from, %{phase: phase} = state)
      when phase in [:running, :done] do
    state = if phase == :running, do: checkpoint(state), else: state
    {:reply, :ok, %{let_go(state) | away: away}}
  end

  def handle_call({what, away}, _from, state) when what in [:release, :stand],
    do: {:reply, :ok, %{state | away: away}}

  # New code: the plan is the same. One that does not start with it stands by, and is taken again with the code before.
  def handle_call(:restart, _from, %{phase: :running} = state) do
    state = state |> checkpoint() |> let_go()

    with {:ok, look} <- Lease.look(state.log, key(state, "lease")),
         {:ok, epoch} <-
           Lease.take(state.log, key(state, "lease"), elem(look, 0), lease_ms(state)) do
      case own(%{state | epoch: epoch}, &{:refused, &1, &2}) do
        {:refused, state, error} -> {:reply, {:error, error}, let_go(state)}
        state -> {:reply, :ok, state}
      end
    else
      # Another node was quicker: it has the part.
      _ -> {:reply, :ok, state}
    end
  end

  def handle_call(:restart, _from, state), do: {:reply, :ok, state}

  # A component fails when it cannot publish any more. The publisher's exit says why.
  defp left?(%{publisher: publisher}), do: not Process.alive?(publisher)

  # It may be lost this moment; then its exit follows.
  defp published(nil), do: nil

  defp published(publisher) do
    Publisher.info(publisher)
  catch
    :exit, _ -> nil
  end

  # Owning

  defp own(state, failed \\ &failed/2) do
    args = %{
      log: state.log,
      deployment: state.deployment.name,
      part: state.part,
      epoch: state.epoch,
      mode: mode(state),
      retain: state.deployment.retain,
      runner: self(),
      streams: Plan.outlets(state.plan, state.part)
    }

    case Publisher.start_link(args) do
      {:ok, publisher} ->
        state = keep(%{state | publisher: publisher})
        Member.route(state.agent, {state.deployment.name, state.part}, state.epoch, publisher)
        run(state, Publisher.resume(publisher), failed)

      {:error, reason} ->
        Logger.warning("#{name(state)}: not taken over: #{explain(reason)}")
        look_again(%{state | epoch: nil, lease: %Lease{}})
    end
  end

  defp keep(state) do
    %{log: log, epoch: epoch, publisher: publisher} = state
    {key, ms} = {key(state, "lease"), lease_ms(state)}
    {:ok, keeper} = Task.start_link(fn -> Lease.keep(log, key, epoch, ms, publisher) end)
    %{state | keeper: keeper}
  end

  # The node before may have been lost between its last checkpoint and the note of its end.
  defp run(state, :done, _failed) do
    note(state, %{"State" => "done"}, "")
    %{state | phase: :done}
  end

  defp run(state, memories, failed) do
    case Assembly.start(state.deployment, state.plan, state.part, %{
           agent: state.agent,
           publisher: state.publisher,
           memories: memories || %{}
         }) do
      {:ok, pipeline} ->
        Process.send_after(self(), :checkpoint, div(state.deployment.checkpoint, 1_000_000))
        monitor = Process.monitor(pipeline)
        %{state | phase: :running, pipeline: pipeline, monitor: monitor}

      {:error, error} ->
        failed.(state, error)
    end
  end

  # A part whose components cannot be carried over is started again from its inputs: it is not asked again.
  defp checkpoint(%{checkpoints: %{possible?: false}} = state), do: state

  defp checkpoint(state) do
    case Pipeline.checkpoint(state.pipeline, &cut(state, &1)) do
      {:ok, memories} ->
        :ok = Publisher.commit(state.publisher, memories)
        taken = state.checkpoints.taken + 1
        %{state | checkpoints: %{state.checkpoints | taken: taken, refused: nil}}

      {:error, %Error{code: :no_snapshot} = error} ->
        if mode(state) == :outbox and Plan.outlets(state.plan, state.part) != [],
          do: failed(state, undeclared(state, error)),
          else: refused(put_in(state.checkpoints.possible?, false), error)

      {:error, error} ->
        refused(state, error)
    end
  catch
    # The publisher has ended: its exit is in the mailbox.
    :exit, _ -> state
  end

  defp cut(state, memories) do
    :ok = Publisher.cut(state.publisher)
    memories
  end

  defp refused(state, error),
    do: %{state | checkpoints: %{state.checkpoints | refused: error}}

  defp undeclared(state, error) do
    Error.new(:no_snapshot, "part #{state.part} cannot be carried over: #{error.what}",
      why: "the outputs of a part are kept with its checkpoints, unless it is deterministic",
      fix: "#{error.fix}; or declare the part deterministic: true",
      meta: error.meta
    )
  end

  defp ended(state) do
    :ok = Publisher.commit(state.publisher, :done)
    note(state, %{"State" => "done"}, "")
    %{state | phase: :done, pipeline: nil, monitor: nil}
  catch
    :exit, _ -> state
  end

  defp failed(state, error) do
    Logger.error("#{name(state)} failed: #{Exception.message(error)}")
    if state.pipeline, do: Process.exit(state.pipeline, :kill)
    note(state, %{"State" => "failed"}, Exception.message(error))
    %{state | phase: :failed, pipeline: nil, monitor: nil, error: error}
  end

  # Processes that wait for the deployment watch this key.
  defp note(state, head, data) do
    subject = {:key, key(state, "state")}

    with {:ok, last} <- Log.last(state.log, subject) do
      head = Map.put(head, "Epoch", Integer.to_string(state.epoch))
      op = "state.#{state.epoch}.#{head["State"]}"
      seq = if last, do: last.seq, else: 0
      Log.append(state.log, subject, seq, %Entry{op: op, head: head, data: data})
    end
  end

  # Another node has the part, or this one could not say that it is alive.
  defp step_down(%{phase: :failed} = state, _reason), do: %{state | publisher: nil, keeper: nil}

  defp step_down(state, reason) do
    Logger.warning("#{name(state)} goes on elsewhere: #{explain(reason)}")
    look_again(kill(state))
  end

  defp kill(state) do
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
        epoch: nil,
        lease: %Lease{}
    }
  end

  # Nothing is under way any more: the part stands still behind its last checkpoint, or what it has put out since is
  # made again elsewhere.
  defp let_go(state) do
    if state.pipeline, do: Pipeline.abandon(state.pipeline)
    send(state.keeper, {:release, self()})

    receive do
      :released -> :ok
    after
      lease_ms(state) -> :ok
    end

    look_again(kill(state))
  end

  defp look_again(state) do
    Process.send_after(self(), :look, poll_ms(state))
    state
  end

  # Which node is preferred: 0 is the first; `nil`: never this one.
  # A drained node waits behind the others, for some seconds; it takes a part that nobody else does.
  defp rank(state) do
    with rank when rank != nil <- Member.rank(state.agent, rule(state), state.part),
         do: rank + @behind * state.away
  end

  defp rule(state), do: state.plan.parts[state.part].rule
  defp mode(state), do: if(rule(state).deterministic, do: :replay, else: :outbox)
  defp lease_ms(state), do: max(div(state.deployment.lease, 1_000_000), 20)
  defp poll_ms(state), do: max(div(lease_ms(state), 10), 5)
  defp wait_ms(state, rank), do: rank * div(lease_ms(state), 2)
  defp owner(%{phase: :standby} = state), do: state.lease.owner
  defp owner(_state), do: Atom.to_string(node())
  defp name(state), do: "#{state.deployment.name}/#{state.part} on #{node()}"
  defp explain({:shutdown, %Error{} = error}), do: Exception.message(error)
  defp explain(reason), do: inspect(reason, limit: 8)

  @doc "The key of the log for one thing about one part."
  @spec key(Deployment.t(), String.t(), String.t()) :: String.t()
  def key(deployment, part, what), do: "#{what}.#{deployment.name}.#{part}"
  defp key(state, what), do: key(state.deployment, state.part, what)

  @impl true
  def terminate(_reason, state) do
    kill(state)
    :ok
  end
end
