defmodule Situ.Simulation.Processes do
  @moduledoc false
  # The processes of a simulation, as the scheduler sees them.
  alias Situ.Simulation.Shell

  # How long (ms) a process may wait for a process outside the simulation before the others continue, and how long all
  # wait before the simulation counts as deadlocked.
  @outside_ms 2_000
  @deadlock_ms 500
  # A process waits here for its turn, or for the VM, which asks another process for information (`Process.info/2`) and
  # always replies.
  @brief_waits [{Shell, :await_turn, 1}, {:erts_internal, :await_result, 1}]
  @quiet_ms 3

  defstruct by_pid: %{}, order: [], labels: %{}, names: %{}, next: 0, starting: 0

  @typedoc """
  `:new` waits for its first turn. `:rests` waits for a message in its shell. `{:waits, n}` is suspended in another
  `receive`, after it has seen `n` messages. `{:runs, before}` has a turn.
  """
  @type status ::
          :new | :rests | {:waits, non_neg_integer()} | {:runs, :new | :rests | :waits}
  @typedoc """
  `order` lists the live processes, in the order of their last turns. `labels` counts the processes of each
  label, and `names` keeps the names of all processes. `starting` counts the processes that have not reported yet.
  """
  @type t :: %__MODULE__{
          by_pid: %{pid() => %{id: non_neg_integer(), label: String.t(), status: status()}},
          order: [pid()],
          labels: %{String.t() => pos_integer()},
          names: %{pid() => String.t()},
          next: non_neg_integer(),
          starting: non_neg_integer()
        }

  @doc "Adds a process that waits for its first turn. A second process of the same label gets a number."
  @spec add_process(t(), pid(), String.t()) :: t()
  def add_process(%__MODULE__{next: id, labels: labels} = processes, pid, label) do
    Process.monitor(pid)
    count = Map.get(labels, label, 0) + 1
    name = if count > 1, do: "#{label} (#{count})", else: label
    entry = %{id: id, label: label, status: :new}

    %{
      processes
      | by_pid: Map.put(processes.by_pid, pid, entry),
        order: processes.order ++ [pid],
        labels: Map.put(labels, label, count),
        names: Map.put(processes.names, pid, name),
        next: id + 1
    }
  end

  @doc "Counts a process that will report its start, or `-1` when it has."
  @spec count_starting(t(), 1 | -1) :: t()
  def count_starting(%__MODULE__{starting: n} = processes, change),
    do: %{processes | starting: n + change}

  @spec starting?(t()) :: boolean()
  def starting?(%__MODULE__{starting: n}), do: n > 0

  @spec member?(t(), pid()) :: boolean()
  def member?(%__MODULE__{by_pid: by_pid}, pid), do: is_map_key(by_pid, pid)

  @doc "Returns the unique name of a process, also after its end."
  @spec process_name(t(), pid()) :: String.t()
  def process_name(%__MODULE__{names: names}, pid), do: Map.get(names, pid, "a process outside")

  @doc "Returns the number of a process: they are numbered in the order of their start."
  @spec process_id(t(), pid()) :: non_neg_integer()
  def process_id(%__MODULE__{by_pid: by_pid}, pid), do: by_pid[pid].id

  @spec process_label(t(), pid()) :: String.t()
  def process_label(%__MODULE__{by_pid: by_pid}, pid), do: by_pid[pid].label

  @doc "Returns the live processes that have one of these labels."
  @spec list_labelled(t(), [String.t()]) :: [pid()]
  def list_labelled(%__MODULE__{order: order, by_pid: by_pid}, labels) do
    order |> Enum.filter(&(by_pid[&1].label in labels)) |> Enum.sort_by(&by_pid[&1].id)
  end

  @spec put_status(t(), pid(), status()) :: t()
  def put_status(%__MODULE__{by_pid: by_pid} = processes, pid, status) do
    case by_pid do
      %{^pid => entry} -> %{processes | by_pid: %{by_pid | pid => %{entry | status: status}}}
      _ended -> processes
    end
  end

  @spec delete_process(t(), pid()) :: t()
  def delete_process(%__MODULE__{} = processes, pid) do
    by_pid = Map.delete(processes.by_pid, pid)
    %{processes | by_pid: by_pid, order: List.delete(processes.order, pid)}
  end

  @doc "Returns the processes that can take a turn, in the order in which they have waited, or a process that has died."
  @spec list_runnable(t()) :: {:ok, [pid()]} | {:died, pid()}
  def list_runnable(%__MODULE__{order: order, by_pid: by_pid}), do: filter(order, by_pid, [])

  defp filter([], _by_pid, runnable), do: {:ok, Enum.reverse(runnable)}

  defp filter([pid | rest], by_pid, runnable) do
    case Process.info(pid, :message_queue_len) do
      nil -> {:died, pid}
      {_, n} -> filter(rest, by_pid, add_runnable(by_pid[pid].status, n, pid, runnable))
    end
  end

  defp add_runnable(:new, _n, pid, runnable), do: [pid | runnable]
  defp add_runnable(:rests, n, pid, runnable) when n > 0, do: [pid | runnable]
  defp add_runnable({:waits, seen}, n, pid, runnable) when n > seen, do: [pid | runnable]
  defp add_runnable(_status, _n, _pid, runnable), do: runnable

  @doc "Returns the processes that wait in the middle of a turn, and not for the reply to a call."
  @spec list_retriable(t()) :: [pid()]
  def list_retriable(%__MODULE__{order: order, by_pid: by_pid}) do
    Enum.filter(order, fn pid ->
      match?({:waits, _seen}, by_pid[pid].status) and
        Process.info(pid, :current_function) != {:current_function, {:gen, :do_call, 4}}
    end)
  end

  @doc "Grants the process a turn."
  @spec grant_turn(t(), pid(), reference()) :: {:new | :rests | :waits, t()}
  def grant_turn(%__MODULE__{by_pid: by_pid, order: order} = processes, pid, ref) do
    kind =
      case by_pid[pid].status do
        {:waits, _seen} ->
          :erlang.resume_process(pid)
          :waits

        status ->
          send(pid, {ref, :go})
          status
      end

    processes = put_status(processes, pid, {:runs, kind})
    {kind, %{processes | order: List.delete(order, pid) ++ [pid]}}
  end

  @doc """
  Suspends a process that waits for a message in the middle of its turn, which began `elapsed` ms ago. Returns `:busy`
  if it runs, and `:outside` if it waits for a process that is not simulated.
  """
  @spec suspend_waiting(t(), pid(), non_neg_integer()) :: {:waiting, t()} | :busy | :outside
  def suspend_waiting(%__MODULE__{} = processes, pid, elapsed) do
    case Process.info(pid, [:status, :message_queue_len, :current_function, :monitors]) do
      [{:status, :waiting}, {_, n}, {_, function}, {_, monitors}] ->
        cond do
          function in @brief_waits or starting?(processes) or reports?() -> :busy
          waits_outside?(processes, function, monitors) and elapsed < @outside_ms -> :outside
          true -> suspend(processes, pid, n)
        end

      _runs_or_ended ->
        :busy
    end
  end

  # Everything that a process has sent before it began to wait has arrived by now.
  defp reports?, do: Process.info(self(), :message_queue_len) != {:message_queue_len, 0}

  # A call monitors its process. The time of a sleep is not simulated.
  defp waits_outside?(_processes, {:timer, :sleep, 1}, _monitors), do: true

  defp waits_outside?(%{by_pid: by_pid}, _function, monitors),
    do: Enum.any?(monitors, &match?({:process, pid} when not is_map_key(by_pid, pid), &1))

  defp suspend(processes, pid, n) do
    :erlang.suspend_process(pid)
    {:waiting, put_status(processes, pid, {:waits, n})}
  rescue
    # The process has been killed in the meantime.
    ArgumentError -> :busy
  end

  @doc "Waits until every other process has the signals that the end of a process sends."
  @spec await_signals(t(), pid()) :: :ok
  def await_signals(%__MODULE__{order: order}, ended),
    do: Enum.each(order, &await_signal(&1, ended))

  defp await_signal(pid, ended) do
    with [{:links, links}, {:monitors, monitors}] <- Process.info(pid, [:links, :monitors]),
         true <- ended in links or {:process, ended} in monitors do
      :erlang.yield()
      await_signal(pid, ended)
    else
      _has_them -> :ok
    end
  end

  @doc "Waits for a message from outside; returns whether one has arrived before all count as deadlocked."
  @spec await_outside(t()) :: boolean()
  def await_outside(%__MODULE__{} = processes) do
    limit =
      if Enum.any?(processes.order, &outside?(processes, &1)), do: @deadlock_ms, else: @quiet_ms

    poll_runnable(processes, limit)
  end

  defp outside?(%{by_pid: by_pid} = processes, pid) do
    with {:waits, _seen} <- by_pid[pid].status,
         [{_, function}, {_, monitors}] <- Process.info(pid, [:current_function, :monitors]) do
      waits_outside?(processes, function, monitors)
    else
      _rests_or_ended -> false
    end
  end

  defp poll_runnable(processes, ms) do
    cond do
      list_runnable(processes) != {:ok, []} ->
        true

      ms <= 0 ->
        false

      true ->
        Process.sleep(1)
        poll_runnable(processes, ms - 1)
    end
  end

  @doc "Describes the state of each process."
  @spec describe_all(t()) :: [{String.t(), String.t()}]
  def describe_all(%__MODULE__{} = processes) do
    for pid <- Enum.sort_by(processes.order, &process_id(processes, &1)),
        do: {process_name(processes, pid), describe(processes.by_pid[pid].status, pid)}
  end

  defp describe(status, pid) do
    case Process.info(pid, [:message_queue_len, :current_function]) do
      [{_, n}, {_, {module, function, arity}}] ->
        describe_status(status, "#{inspect(module)}.#{function}/#{arity}") <> describe_count(n)

      nil ->
        "has ended"
    end
  end

  defp describe_status(:new, _function), do: "waits for its first turn"
  defp describe_status(:rests, _function), do: "waits for a message"
  defp describe_status({:waits, _}, function), do: "waits in #{function}"
  defp describe_status({:runs, _}, function), do: "runs #{function}"

  defp describe_count(0), do: ""
  defp describe_count(1), do: ", 1 message in its mailbox"
  defp describe_count(n), do: ", #{n} messages in its mailbox"

  @doc "Kills all processes and waits for their end."
  @spec kill_all(t()) :: :ok
  def kill_all(%__MODULE__{order: order}) do
    Enum.each(order, &Process.exit(&1, :kill))

    for pid <- order do
      receive do
        {:DOWN, _monitor, :process, ^pid, _reason} -> :ok
      end
    end

    :ok
  end
end
