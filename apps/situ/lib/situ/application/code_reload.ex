defmodule Situ.Application.CodeReload do
  @moduledoc false
  # Notices when the module of a running pipeline is reloaded, and sends the pipeline `:situ_reloaded`. The VM keeps
  # two versions of a module. When a third version is loaded, it kills every process that still holds functions of the
  # oldest. A pipeline therefore replaces its operators' functions as soon as a new version is loaded.
  use GenServer

  @every_ms 50

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_), do: GenServer.start_link(__MODULE__, [], name: __MODULE__)

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
