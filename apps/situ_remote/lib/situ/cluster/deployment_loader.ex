defmodule Situ.Cluster.DeploymentLoader do
  @moduledoc false
  # Gives a node that has just started the deployments in the log, so that a cluster all of whose nodes were lost runs
  # again what it ran; those that have ended stay in the log alone. Waits for a log that is away.
  use Task, restart: :transient

  alias Situ.Cluster.{Assembly, Deployments, Runner, SealedLog}
  alias Situ.Remote.Log
  require Logger

  @again_ms 500

  @spec start_link({Log.t(), GenServer.server()}) :: {:ok, pid()}
  def start_link({log, agent}), do: Task.start_link(__MODULE__, :run, [log, agent, false])

  @doc false
  @spec run(Log.t(), GenServer.server(), boolean()) :: :ok
  def run(log, agent, told?) do
    case load_all(log, agent) do
      :ok ->
        if told?, do: Logger.warning("the log is there now")
        :ok

      {:error, %{code: :log_away} = error} ->
        unless told?,
          do: Logger.warning("this node waits for its log: #{Exception.message(error)}")

        receive do
        after
          @again_ms -> run(log, agent, true)
        end

      {:error, error} ->
        Logger.error("deployments of before do not run again: #{Exception.message(error)}")
    end
  end

  defp load_all(log, agent) do
    with {:ok, deployments} <- Deployments.all(log) do
      Enum.reduce_while(deployments, :ok, fn deployment, :ok ->
        case load(log, agent, deployment) do
          :ok -> {:cont, :ok}
          {:error, error} -> {:halt, {:error, error}}
        end
      end)
    end
  end

  defp load(log, agent, %{name: name} = deployment) do
    case Deployments.there?(log, name, deployment.run) do
      {:ok, true} ->
        unless ended?(log, deployment), do: GenServer.cast(agent, {:install, deployment})
        :ok

      {:ok, false} ->
        Deployments.delete(log, name)

      {:error, error} ->
        {:error, error}
    end
  end

  defp ended?(log, deployment) do
    log = SealedLog.new(log, deployment.run)

    with {:ok, plan} <- Assembly.plan(deployment) do
      Enum.all?(plan.parts, fn {part, _} ->
        state = Log.last(log, {:key, Runner.key(deployment, part, "state")})
        match?({:ok, %{head: %{"State" => how}}} when how in ["done", "failed"], state)
      end)
    else
      # The agent says why it cannot be built.
      {:error, _error} -> false
    end
  end
end
