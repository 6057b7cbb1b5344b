defmodule Situ.Cluster.Completion do
  @moduledoc false
  # Waits for the end of a deployment's parts. The runner of a part writes its end or failure to the log, so this works
  # on every node, even if the node that ran the part has been lost.
  alias Situ.Cluster.{Deployment, Runner, SignedEntry}
  alias Situ.Error
  alias Situ.Cluster.Log

  @doc "Waits until all `parts` have ended, a part has failed, or `deadline` (monotonic ms) has passed."
  @spec await_parts(Log.t(), Deployment.t(), [String.t()], integer() | :infinity) ::
          :ok | {:error, Error.t()}
  def await_parts(log, deployment, parts, deadline) do
    started = monotonic_ms()

    states =
      for part <- parts,
          do: {part, Log.fetch_last(log, {:key, Runner.log_key(deployment, part, "state")})}

    unfinished =
      for {part, state} <- states,
          not match?({:ok, %{head: %{"State" => "done"}}}, state),
          do: part

    failures =
      for {part, {:ok, %{head: %{"State" => "failed"}, data: text}}} <- states, do: {part, text}

    refusals = for {_, {:error, error}} <- states, SignedEntry.refusal?(error), do: error

    # A failed part is reported immediately, even while others are running. A rejected state entry counts as a failure.
    cond do
      refusals != [] ->
        {:error, hd(refusals)}

      failures != [] ->
        {:error, failure_error(deployment, hd(failures))}

      unfinished == [] ->
        :ok

      deadline != :infinity and monotonic_ms() > deadline ->
        {:error, timeout_error(deployment, hd(unfinished))}

      true ->
        # With many parts or a slow log, most of the time passes without reading.
        wait_ms((4 * (monotonic_ms() - started)) |> max(50) |> min(2_000))
        await_parts(log, deployment, unfinished, deadline)
    end
  end

  defp wait_ms(ms) do
    receive do
    after
      ms -> :ok
    end
  end

  defp failure_error(deployment, {part, text}),
    do: Error.new(:part_failed, "part #{part} of #{deployment.name} failed: #{text}")

  defp timeout_error(deployment, part),
    do: Error.new(:timeout, "part #{part} of #{deployment.name} has not ended yet")

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
