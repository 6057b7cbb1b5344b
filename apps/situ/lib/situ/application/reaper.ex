defmodule Situ.Application.Reaper do
  @moduledoc false
  # When a pipeline's process is killed, its components end by themselves, unless a component is stuck in a loop. This
  # process monitors pipelines and, after a grace period, kills any process that a dead pipeline left running.
  use GenServer

  @grace_ms 5_000

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts) do
    case Keyword.get(opts, :name, __MODULE__) do
      nil -> GenServer.start_link(__MODULE__, opts)
      name -> GenServer.start_link(__MODULE__, opts, name: name)
    end
  end

  @doc "Watches the pipeline's process from now on; does nothing if the reaper process is not running."
  @spec watch_pipeline(pid(), GenServer.server()) :: :ok
  def watch_pipeline(pipeline, reaper \\ __MODULE__) do
    GenServer.call(reaper, {:watch, pipeline})
  catch
    :exit, _ -> :ok
  end

  @impl true
  def init(opts), do: {:ok, Keyword.get(opts, :grace_ms, @grace_ms)}

  @impl true
  def handle_call({:watch, pipeline}, _from, grace) do
    Process.monitor(pipeline)
    {:reply, :ok, grace}
  end

  @impl true
  def handle_info({:DOWN, _ref, :process, pipeline, reason}, grace)
      when reason in [:killed, {:shutdown, :crashed}] or elem(reason, 0) == :pipeline_failed do
    Process.send_after(self(), {:reap, pipeline}, grace)
    {:noreply, grace}
  end

  def handle_info({:reap, pipeline}, grace) do
    for pid <- Process.list(), left_behind?(pid, pipeline), do: Process.exit(pid, :kill)
    {:noreply, grace}
  end

  def handle_info(_other, grace), do: {:noreply, grace}

  defp left_behind?(pid, pipeline) do
    case Process.info(pid, :dictionary) do
      {:dictionary, dictionary} ->
        List.keyfind(dictionary, :situ_pipeline, 0) == {:situ_pipeline, pipeline}

      nil ->
        false
    end
  end
end
