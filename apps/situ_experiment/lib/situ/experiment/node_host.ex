defmodule Situ.Experiment.NodeHost do
  @moduledoc false
  # A node's part of a run: takes the code of the experiment, compares it with the code of the node that started the
  # run (the owner), and computes trials. Results go back to the process that asked for them.
  #
  #     owner: NodePool ── erpc ──> NodeHost        one for each node, with a registered name: a node takes part in one
  #                                   └── job       run at a time, so two versions of a module never meet
  #
  # The host ends with the run: it monitors the pool, and with a lost connection the pool counts as ended. It then kills
  # its jobs, with their pipelines, and deletes its folder. If the node is killed, the next host deletes the folder.
  # No supervisor restarts a host, because the run would not know the new one.
  use GenServer
  alias Situ.Error

  alias Situ.Experiment.{CodeVersion, Context, Provenance, RecordingCache, Trial}

  @call_ms 120_000
  # A host whose owner has just ended needs a moment to end as well.
  @busy_ms 10_000

  @typedoc """
  The run: its module, the modules that were compiled from its file, the hashes of its code, the versions and started
  applications of the owner, and the folder of its results there.
  """
  @type setup :: %{
          pool: pid(),
          module: module(),
          binaries: %{module() => binary()},
          parts: CodeVersion.parts(),
          versions: map(),
          apps: [atom()],
          peer: Context.peer()
        }

  @type job :: %{trial: Trial.t(), inputs: RecordingCache.inputs()}

  @doc """
  Starts the host of this node for a run, and returns its process and folder. Errors: `:busy_node`, `:other_version`,
  `:other_code`, `:module_exists`, `:not_saved`.
  """
  @spec start(setup()) :: {:ok, {pid(), Path.t(), machine :: map()}} | {:error, Error.t()}
  def start(setup) do
    with {:ok, pid} <- claim_node(setup.pool, nil),
         {:ok, folder} <- GenServer.call(pid, {:prepare, setup}, @call_ms),
         do: {:ok, {pid, folder, Provenance.describe_machine()}}
  end

  defp claim_node(pool, ended) do
    case GenServer.start(__MODULE__, pool, name: __MODULE__) do
      {:ok, pid} -> {:ok, pid}
      {:error, {:already_started, pid}} when pid != ended -> await_end(pid, pool)
      _ -> {:error, busy_error()}
    end
  end

  defp await_end(pid, pool) do
    monitor = Process.monitor(pid)

    receive do
      {:DOWN, ^monitor, _, _, _} -> claim_node(pool, pid)
    after
      @busy_ms ->
        Process.demonitor(monitor, [:flush])
        {:error, busy_error()}
    end
  end

  defp busy_error do
    Error.new(:busy_node, "#{node()} is computing another experiment",
      why: "a node takes part in one run at a time",
      fix: "wait until the other run has ended, or start another node"
    )
  end

  @doc "Asks a host to compute a job. The calling process gets `{tag, {:ok, result} | {:error, error}}`."
  @spec request_job(pid(), job(), reference()) :: :ok
  def request_job(host, job, tag), do: GenServer.cast(host, {:run, job, {self(), tag}})

  @doc "Deletes the output of a job, after the owner has copied it."
  @spec delete_output(pid(), relative :: Path.t()) :: :ok
  def delete_output(host, relative), do: GenServer.cast(host, {:delete, relative})

  @doc "Ends a host that cannot compute trials."
  @spec stop(pid()) :: :ok
  def stop(host), do: GenServer.cast(host, :stop)

  @impl true
  def init(pool) do
    Process.flag(:trap_exit, true)
    {:ok, %{owner: Process.monitor(pool), context: nil, jobs: %{}}}
  end

  @impl true
  def handle_call({:prepare, setup}, _from, state) do
    case prepare_run(setup) do
      {:ok, context} ->
        {:reply, {:ok, context.folder}, %{state | context: context}}

      {:error, error} ->
        {:stop, :normal, {:error, error}, state}
    end
  end

  defp prepare_run(setup) do
    with :ok <- check_versions(setup.versions),
         :ok <- start_apps(setup.apps),
         :ok <- load_modules(setup.binaries),
         code = CodeVersion.new(setup.binaries),
         :ok <- check_code(code, setup.parts),
         {:ok, folder} <- create_folder() do
      RecordingCache.delete_old_copies(System.os_time(:second))
      {:ok, %Context{module: setup.module, folder: folder, code: code, peer: setup.peer}}
    end
  end

  # A patch of OTP changes no results; the code itself is compared by its hashes.
  defp check_versions(versions) do
    own = Provenance.list_versions()

    different =
      for {name, theirs} <- versions,
          select_release(name, own[name]) != select_release(name, theirs),
          do: "#{name} is #{own[name]} there, and #{theirs} here"

    if different == [],
      do: :ok,
      else: {:error, version_error(Enum.join(different, "; "))}
  end

  defp select_release("otp", version), do: version |> String.split(".") |> hd()
  defp select_release(_name, version), do: version

  defp version_error(why) do
    Error.new(:other_version, "#{node()} runs other versions",
      why: why,
      fix: "install the same release on all machines, and start the nodes again"
    )
  end

  # An application that does not exist here is a difference of the code, if the experiment uses it.
  defp start_apps(apps), do: Enum.each(apps, &Application.ensure_all_started/1)

  defp load_modules(binaries) do
    Enum.find_value(binaries, :ok, fn {module, beam} ->
      with {:error, why} <- load_module(module, beam), do: {:error, load_error(module, why)}
    end)
    |> case do
      {:error, error} -> {:error, error}
      _ -> :ok
    end
  end

  defp load_module(module, beam) do
    {:ok, {_, md5}} = :beam_lib.md5(beam)

    cond do
      loaded_hash(module) == md5 -> nil
      :code.where_is_file(~c"#{module}.beam") != :non_existing -> {:error, "the node has its own"}
      not :code.soft_purge(module) -> {:error, "a process still runs its old code"}
      true -> load_binary(module, beam)
    end
  end

  defp load_binary(module, beam) do
    case :code.load_binary(module, ~c"experiment", beam) do
      {:module, _} -> nil
      {:error, reason} -> {:error, inspect(reason)}
    end
  end

  defp loaded_hash(module), do: :code.is_loaded(module) && module.module_info(:md5)

  defp load_error(module, why) do
    Error.new(:module_exists, "#{node()} cannot load #{inspect(module)}",
      why: why,
      fix: "give the module of the experiment another name, or start the node again"
    )
  end

  defp check_code(code, parts) do
    case CodeVersion.find_differences(code, parts) do
      [] ->
        :ok

      names ->
        shown = names |> Enum.take(5) |> Enum.join(", ")
        more = if length(names) > 5, do: " and #{length(names) - 5} more", else: ""

        {:error,
         Error.new(:other_code, "#{node()} has other code than this machine",
           why: "these are different or missing there: #{shown}#{more}",
           fix: "install the same release on all machines, and start the nodes again"
         )}
    end
  end

  # The path contains the machine and the process of the VM, so a later host finds the folders of killed nodes, and the
  # remains of a pipeline that was still writing when its run was cancelled.
  defp create_folder do
    %{"host" => host} = Provenance.describe_machine()
    root = Path.join([RecordingCache.cache_folder(), "runs", host])
    folder = Path.join(root, "#{System.pid()}-#{System.unique_integer([:positive])}")

    for path <- Path.wildcard(Path.join(root, "*")),
        [pid | _] = path |> Path.basename() |> String.split("-"),
        pid == System.pid() or not File.dir?("/proc/#{pid}"),
        do: File.rm_rf(path)

    with :ok <- File.mkdir_p(Path.join(folder, "outputs")),
         :ok <- File.mkdir_p(Path.join(RecordingCache.cache_folder(), "recordings")) do
      {:ok, folder}
    else
      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "#{node()} cannot create #{folder}",
           why: to_string(:file.format_error(reason)),
           fix: "set XDG_CACHE_HOME of the node to a folder that it can write to"
         )}
    end
  end

  @impl true
  def handle_cast({:run, job, reply_to}, %{context: context} = state) do
    host = self()
    pid = spawn_link(fn -> send(host, {:computed, self(), compute_job(job, context)}) end)
    {:noreply, put_in(state.jobs[pid], reply_to)}
  end

  def handle_cast({:delete, relative}, %{context: context} = state) do
    _ = File.rm_rf(Path.join(context.folder, relative))
    {:noreply, state}
  end

  def handle_cast(:stop, state), do: {:stop, :normal, state}

  defp compute_job(%{trial: trial, inputs: inputs}, context) do
    with {:ok, session} <-
           RecordingCache.locate_session(trial.session, inputs, context.peer.node),
         do: {:ok, Trial.run_trial(%{trial | session: session}, context)}
  end

  @impl true
  def handle_info({:computed, pid, reply}, state), do: {:noreply, reply(state, pid, reply)}

  def handle_info({:EXIT, pid, reason}, state) when is_map_key(state.jobs, pid) do
    error =
      Error.new(:job_crashed, "a trial crashed on #{node()}", why: inspect(reason, limit: 10))

    {:noreply, reply(state, pid, {:error, error})}
  end

  def handle_info({:DOWN, owner, _, _, _}, %{owner: owner} = state),
    do: {:stop, :normal, state}

  def handle_info(_other, state), do: {:noreply, state}

  defp reply(state, pid, reply) do
    {{to, tag}, state} = pop_in(state.jobs[pid])
    send(to, {tag, reply})
    state
  end

  @impl true
  def terminate(_reason, state) do
    for {pid, _} <- state.jobs do
      Process.exit(pid, :kill)

      receive do
        {:EXIT, ^pid, _} -> :ok
      end
    end

    if state.context, do: File.rm_rf(state.context.folder)
  end
end
