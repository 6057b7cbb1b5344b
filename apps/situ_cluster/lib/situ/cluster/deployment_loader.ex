defmodule Situ.Cluster.DeploymentLoader do
  @moduledoc false
  # Installs the deployments in the log on a node that has just started, so that a cluster that lost all of its nodes
  # runs them again. Deployments that have ended are not installed. Waits while the log is unreachable.
  use Task, restart: :transient

  alias Situ.Cluster.{PartStarter, Deployments, Runner, SealedLog}
  alias Situ.Cluster.Log
  require Logger

  @again_ms 500

  @spec start_link({Log.t(), GenServer.server()}) :: {:ok, pid()}
  def start_link({log, agent}), do: Task.start_link(__MODULE__, :run, [log, agent, false])

  @doc false
  @spec run(Log.t(), GenServer.server(), boolean()) :: :ok
  def run(log, agent, warned?) do
    case load_all(log, agent) do
      :ok ->
        if warned?, do: Logger.warning("the log is reachable now")
        :ok

      {:error, %{code: :log_away} = error} ->
        unless warned?,
          do: Logger.warning("this node is waiting for its log: #{Exception.message(error)}")

        receive do
        after
          @again_ms -> run(log, agent, true)
        end

      {:error, error} ->
        Logger.error(
          "the deployments in the log cannot be restarted: #{Exception.message(error)}"
        )
    end
  end

  defp load_all(log, agent) do
    with {:ok, deployments} <- Deployments.list_active(log),
         do: Enum.find_value(deployments, :ok, &load_failure(log, agent, &1))
  end

  # Only an unreachable log stops the loop. A deployment with a refused entry must not keep the others from running.
  defp load_failure(log, agent, %{name: name} = deployment) do
    case load_deployment(log, agent, deployment) do
      :ok ->
        nil

      {:error, %{code: :log_away}} = unreachable ->
        unreachable

      {:error, error} ->
        Logger.error(
          "the deployment #{inspect(name)} cannot be restarted: #{Exception.message(error)}"
        )

        nil
    end
  end

  defp load_deployment(log, agent, %{name: name} = deployment) do
    case Deployments.find_log(log, name, deployment.run) do
      {:ok, true} ->
        unless all_parts_ended?(log, deployment),
          do: GenServer.cast(agent, {:install, deployment})

        :ok

      {:ok, false} ->
        Deployments.delete(log, name)

      {:error, error} ->
        {:error, error}
    end
  end

  defp all_parts_ended?(log, deployment) do
    log = SealedLog.new(log, deployment.run)

    with {:ok, plan} <- PartStarter.build_plan(deployment) do
      Enum.all?(plan.parts, fn {part, _} ->
        state = Log.fetch_last(log, {:key, Runner.log_key(deployment, part, "state")})
        match?({:ok, %{head: %{"State" => phase}}} when phase in ["done", "failed"], state)
      end)
    else
      # The agent reports the reason when it fails to build the deployment.
      {:error, _error} -> false
    end
  end
end
