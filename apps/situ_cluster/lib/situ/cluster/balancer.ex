defmodule Situ.Cluster.Balancer do
  @moduledoc false
  # Checks regularly whether a part of a deployment with `balance:` should move. The first member checks for all. If
  # two members both consider themselves the first, a part moves twice, which does no harm. The balancer reads the
  # agent's table instead of calling the agent, since a call to a busy agent could time out and end both.
  use GenServer
  alias Situ.Cluster.Member
  require Logger

  @check_ms 500

  @spec start_link((Situ.Cluster.Deployment.t() -> term())) :: GenServer.on_start()
  def start_link(balance), do: GenServer.start_link(__MODULE__, balance)

  @impl true
  def init(balance) do
    Process.send_after(self(), :check, @check_ms)
    {:ok, %{balance: balance, due_times: %{}}}
  end

  @impl true
  def handle_info(:check, state) do
    Process.send_after(self(), :check, @check_ms)
    first? = Member.first_member?()

    balanced =
      for %{balance: interval} = d when interval != nil <- Member.list_deployments(), do: d

    due_times =
      Map.new(
        balanced,
        &{&1.name, Map.get(state.due_times, &1.name, monotonic_ns() + &1.balance)}
      )

    due_times =
      for d <- balanced, first?, monotonic_ns() >= due_times[d.name], reduce: due_times do
        due_times ->
          _ = balance_deployment(state.balance, d)
          Map.put(due_times, d.name, monotonic_ns() + d.balance)
      end

    {:noreply, %{state | due_times: due_times}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp balance_deployment(balance, deployment) do
    case balance.(deployment) do
      {:ok, {part, to}} ->
        Logger.info("#{deployment.name}/#{part} moved to #{to}, which is less busy")

      {:ok, nil} ->
        :ok

      {:error, error} ->
        Logger.warning(Exception.message(error))
    end
  catch
    # A node was lost during the move.
    :exit, _ -> :ok
  end

  defp monotonic_ns, do: System.monotonic_time(:nanosecond)
end
