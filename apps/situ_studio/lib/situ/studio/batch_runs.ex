defmodule Situ.Studio.BatchRuns do
  @moduledoc false
  # Manages the batch runs of a studio. A run continues after the page that started it is closed,
  # and every page of the dataset shows it. A run that was interrupted by a server crash is
  # offered again (`Situ.Studio.BatchRuns.ResumableRuns`) and processes only the remaining
  # sessions (`Situ.Dataset.derive/3`).
  use GenServer

  alias Situ.Dataset.{Derivation, Server, Task}
  alias Situ.Error
  alias Situ.Experiment.TaskProvenance
  alias Situ.Studio.BatchRuns.{ResumableRuns, Run}
  alias Situ.Studio.Datasets

  # The minimum interval between page updates, and the number of finished runs to keep.
  @tell_ms 250
  @max_runs 20

  @doc "Starts the batch runner of the studio `:id`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts[:id], name: via(opts[:id]))

  defp via(id), do: {:via, Registry, {Situ.Studio.Registry, {id, :batch}}}

  @doc "Returns the runs over the dataset in `file`, newest first, and sends updates as `{:batch, file, runs}`."
  @spec subscribe(String.t(), Path.t()) :: [Run.t()]
  def subscribe(studio, file), do: GenServer.call(via(studio), {:subscribe, file, self()})

  @doc """
  Starts the task `task` over `sessions` of the dataset; `config` contains its options as read from a page or a file.
  `opts`: `:output` (default: the task's output), `:overwrite`, `:parallel`. Errors: `:no_task`, invalid options, and
  `:busy` when a run with the same output is in progress.
  """
  @spec start_run(String.t(), {pid(), Path.t()}, String.t(), [String.t()], map(), keyword()) ::
          {:ok, pos_integer()} | {:error, Error.t()}
  def start_run(studio, {server, file}, task, sessions, config, opts \\ []) do
    with {:ok, module} <- Task.fetch_task(task),
         %{options: schema, output: output} = module.task(),
         {:ok, options} <- Situ.Options.parse(config, schema),
         {:ok, dataset} <- Datasets.reload_dataset(server),
         {:ok, chosen} <- select_sessions(dataset, sessions) do
      opts = Keyword.put_new(opts, :output, output)
      note = %{task: task, sessions: Enum.map(chosen, & &1.name), config: config}
      note = Map.merge(note, %{output: opts[:output], parallel: opts[:parallel] || 1})
      job = {module, chosen, [options: options] ++ opts, note}
      GenServer.call(via(studio), {:start, {server, file}, task, job})
    end
  end

  defp select_sessions(dataset, names) do
    case Enum.filter(dataset.sessions, &(&1.name in names)) do
      [] -> {:error, Error.new(:no_session, "no session is selected", fix: "select at least one")}
      sessions -> {:ok, sessions}
    end
  end

  @doc "Cancels a run; finished sessions keep their output."
  @spec cancel_run(String.t(), pos_integer()) :: :ok
  def cancel_run(studio, id), do: GenServer.call(via(studio), {:cancel, id})

  @impl true
  def init(_id),
    do: {:ok, %{runs: [], tasks: %{}, next: 1, subscribers: %{}, last_notice: 0, due: nil}}

  @impl true
  def handle_call({:subscribe, file, pid}, _from, state) do
    monitor = Process.monitor(pid)
    subscribers = Map.put(state.subscribers, monitor, {pid, file})
    {:reply, runs_of_file(state, file), %{state | subscribers: subscribers}}
  end

  def handle_call(
        {:start, {_, file} = dataset, task, {module, sessions, opts, note}},
        _from,
        state
      ) do
    job = {module, sessions, opts}

    if output_busy?(state, file, opts[:output]) do
      {:reply, {:error, busy_error(opts[:output] || task)}, state}
    else
      cancel = :counters.new(1, [])
      id = state.next

      run = %Run{
        id: id,
        file: file,
        task: task,
        output: opts[:output],
        sessions: Enum.map(sessions, & &1.name),
        cancel: cancel,
        began: monotonic_ms()
      }

      :ok = ResumableRuns.record_start(file, note)
      %{ref: ref} = start_task(self(), id, dataset, job, cancel)
      state = %{state | next: id + 1, tasks: Map.put(state.tasks, ref, id)}

      {:reply, {:ok, id},
       notify_subscribers(%{state | runs: Enum.take([run | state.runs], @max_runs)})}
    end
  end

  def handle_call({:cancel, id}, _from, state) do
    for %Run{id: ^id, cancel: cancel} <- state.runs, do: :counters.put(cancel, 1, 1)
    {:reply, :ok, state}
  end

  defp output_busy?(state, file, output),
    do: Enum.any?(state.runs, &match?(%{file: ^file, output: ^output, status: :running}, &1))

  defp busy_error(name),
    do: Error.new(:busy, "#{name} is already being computed", fix: "wait for it, or cancel it")

  defp start_task(owner, id, {server, _file}, {module, sessions, opts}, cancel) do
    commit = fn server, session, partition ->
      with {:ok, _} <- Datasets.put_partition(server, session.name, partition),
           do: {:ok, server}
    end

    opts =
      [
        progress: &send(owner, {:progress, id, &1}),
        cancel: fn -> :counters.get(cancel, 1) > 0 end
      ] ++ opts

    Elixir.Task.Supervisor.async_nolink(Situ.Studio.Tasks, fn ->
      opts = put_provenance(opts, module)
      Derivation.run(sessions, module, Server.get_dataset(server).file, {server, commit}, opts)
    end)
  end

  # The code of a task is read from disk, which takes time, so the run does it.
  defp put_provenance(opts, module) do
    name = module.task().name
    output = opts[:output]

    if output,
      do: [
        {:provenance, TaskProvenance.describe_runs(name, {module, %{}}, opts[:options], output)}
        | opts
      ],
      else: opts
  end

  @impl true
  def handle_info({:progress, id, progress}, state),
    do:
      {:noreply, state |> update_run(id, &Run.update_progress(&1, progress)) |> schedule_update()}

  def handle_info({ref, result}, %{tasks: tasks} = state) when is_map_key(tasks, ref) do
    Process.demonitor(ref, [:flush])
    {:noreply, finish_run(state, ref, result)}
  end

  def handle_info({:DOWN, ref, _, _, reason}, %{tasks: tasks} = state)
      when is_map_key(tasks, ref) do
    error = Error.new(:run_crashed, "the run crashed: #{inspect(reason, limit: 10)}")
    {:noreply, finish_run(state, ref, {:error, error})}
  end

  def handle_info({:DOWN, monitor, _, _, _}, state),
    do: {:noreply, %{state | subscribers: Map.delete(state.subscribers, monitor)}}

  def handle_info(:tell, state), do: {:noreply, notify_subscribers(state)}
  def handle_info(_stray, state), do: {:noreply, state}

  defp finish_run(state, ref, result) do
    {id, tasks} = Map.pop!(state.tasks, ref)

    for %Run{id: ^id, file: file, output: output} <- state.runs,
        do: ResumableRuns.delete_record(file, output)

    notify_subscribers(
      update_run(%{state | tasks: tasks}, id, &Run.finish(&1, result, monotonic_ms()))
    )
  end

  defp update_run(state, id, fun),
    do: %{state | runs: Enum.map(state.runs, &if(&1.id == id, do: fun.(&1), else: &1))}

  # Limits updates to a rate that pages can draw.
  defp schedule_update(%{due: nil} = state) do
    case monotonic_ms() - state.last_notice do
      ago when ago >= @tell_ms -> notify_subscribers(state)
      ago -> %{state | due: Process.send_after(self(), :tell, @tell_ms - ago)}
    end
  end

  defp schedule_update(state), do: state

  defp notify_subscribers(state) do
    if state.due, do: Process.cancel_timer(state.due)

    for {_, {pid, file}} <- state.subscribers,
        do: send(pid, {:batch, file, runs_of_file(state, file)})

    %{state | last_notice: monotonic_ms(), due: nil}
  end

  defp runs_of_file(state, file), do: Enum.filter(state.runs, &(&1.file == file))

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
