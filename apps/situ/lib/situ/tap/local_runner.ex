defmodule Situ.Tap.LocalRunner do
  @moduledoc false
  # Runs the function of a tap on a pipeline of another node. Ends with the process that attached the tap and with the
  # pipeline.
  use GenServer
  require Logger

  @spec start((Situ.Message.t() -> any())) :: pid()
  def start(fun) do
    {:ok, runner} = GenServer.start(__MODULE__, {fun, self()})
    runner
  end

  @spec watch_pipeline(pid(), pid()) :: :ok
  def watch_pipeline(runner, pipeline), do: GenServer.cast(runner, {:watch, pipeline})

  @spec stop(pid()) :: :ok
  def stop(runner), do: GenServer.cast(runner, :stop)

  # Returns when the function has handled the message, or immediately if the process has ended.
  @spec hand_over(pid(), Situ.Message.t()) :: :ok
  def hand_over(runner, message) do
    GenServer.call(runner, {:message, message}, :infinity)
  catch
    :exit, _ -> :ok
  end

  @impl true
  def init({fun, owner}) do
    Process.monitor(owner)
    {:ok, fun}
  end

  @impl true
  def handle_call({:message, message}, _from, fun) do
    fun.(message)
    {:reply, :ok, fun}
  rescue
    error ->
      Logger.warning("the function of a tap raised: " <> Exception.message(error))
      {:reply, :ok, fun}
  end

  @impl true
  def handle_cast({:watch, pipeline}, fun) do
    Process.monitor(pipeline)
    {:noreply, fun}
  end

  def handle_cast(:stop, fun), do: {:stop, :normal, fun}

  @impl true
  def handle_info({:DOWN, _monitor, :process, _pid, _reason}, fun), do: {:stop, :normal, fun}
  def handle_info(_other, fun), do: {:noreply, fun}
end
