defmodule Situ.Application.CodeReload do
  @moduledoc false
  # Notices when the module of a running pipeline is reloaded, and sends the pipeline `:situ_reloaded`. The VM keeps
  # two versions of a module. When a third version is loaded, functions of the oldest raise, and processes that execute
  # it are killed. A pipeline therefore replaces its operators' functions as soon as a new version is loaded, and the
  # compiler waits for it (`await_reload/1`).
  use GenServer

  @every_ms 50
  @longest_ms 5_000

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_), do: GenServer.start_link(__MODULE__, [], name: __MODULE__)

  @doc """
  Waits until all pipelines of `module` use its newest version and no process executes the one before, for at most five
  seconds.
  """
  @spec await_reload(module()) :: :ok
  def await_reload(module) do
    deadline = System.monotonic_time(:millisecond) + @longest_ms

    case list_watchers(module) -- [self()] do
      [] ->
        :ok

      pipelines ->
        await_functions(pipelines, deadline)
        await_processes(module, deadline)
    end
  end

  # No pipeline runs in a compiler without the application.
  defp list_watchers(module) do
    if Process.whereis(__MODULE__), do: GenServer.call(__MODULE__, {:watchers, module}), else: []
  catch
    :exit, _ -> []
  end

  defp await_functions(pipelines, deadline) do
    for pid <- pipelines, reload = request_reload(pid, remaining_ms(deadline)), reload != nil do
      monitor = Process.monitor(reload)

      receive do
        {:DOWN, ^monitor, :process, _pid, _reason} -> :ok
      after
        remaining_ms(deadline) -> Process.demonitor(monitor, [:flush])
      end
    end
  end

  # Returns the process that replaces the functions, if the pipeline has to replace any.
  defp request_reload(pid, timeout) do
    GenServer.call(pid, :reload, timeout)
  catch
    :exit, _ -> nil
  end

  defp await_processes(module, deadline) do
    others = Process.list() -- [self()]

    if remaining_ms(deadline) > 0 and Enum.any?(others, &:erlang.check_process_code(&1, module)) do
      Process.sleep(5)
      await_processes(module, deadline)
    else
      :ok
    end
  end

  defp remaining_ms(deadline), do: max(deadline - System.monotonic_time(:millisecond), 0)

  @doc "Notifies the calling process of each version of `module` after `seen`, the version the pipeline was built with."
  @spec watch_module(module(), binary() | nil) :: :ok
  def watch_module(module, seen), do: GenServer.cast(__MODULE__, {:watch, module, seen, self()})

  @impl true
  def init(_), do: {:ok, %{}}

  @impl true
  def handle_cast({:watch, module, seen, pid}, watched) do
    Process.monitor(pid)
    if watched == %{}, do: schedule_check()
    {:noreply, Map.put(watched, pid, {module, seen})}
  end

  @impl true
  def handle_call({:watchers, module}, _from, watched),
    do: {:reply, for({pid, {^module, _}} <- watched, do: pid), watched}

  @impl true
  def handle_info(:look, watched) do
    if watched != %{}, do: schedule_check()
    {:noreply, Map.new(watched, &check_version/1)}
  end

  def handle_info({:DOWN, _ref, :process, pid, _reason}, watched),
    do: {:noreply, Map.delete(watched, pid)}

  def handle_info(_other, watched), do: {:noreply, watched}

  defp check_version({pid, {module, seen}}) do
    case code_version(module) do
      version when version in [seen, nil] ->
        {pid, {module, seen}}

      version ->
        send(pid, :situ_reloaded)
        {pid, {module, version}}
    end
  end

  @doc "Returns the version of the loaded code, or `nil` while the module is being loaded."
  @spec code_version(module()) :: binary() | nil
  def code_version(module) do
    if :erlang.module_loaded(module), do: module.module_info(:md5)
  rescue
    UndefinedFunctionError -> nil
  end

  defp schedule_check, do: Process.send_after(self(), :look, @every_ms)
end
