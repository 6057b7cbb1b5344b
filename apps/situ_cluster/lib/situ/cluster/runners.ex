defmodule Situ.Cluster.Runners do
  @moduledoc false
  # Queries or ends several runners in parallel, on any nodes, so that an unresponsive runner does not delay the
  # others.
  alias Situ.Cluster.Runner

  @dismiss_ms 5_000

  @doc "Returns the state of each runner, or `%{}` for a runner that does not reply within `timeout` ms."
  @spec collect_infos([pid()], timeout()) :: [map()]
  def collect_infos(runners, timeout) do
    requests = for runner <- runners, do: :gen_server.send_request(runner, :info)
    deadline = monotonic_ms() + timeout

    for request <- requests,
        do:
          info_or_empty(:gen_server.receive_response(request, max(deadline - monotonic_ms(), 0)))
  end

  defp info_or_empty({:reply, info}), do: info
  defp info_or_empty(_timeout_or_error), do: %{}

  @doc "Ends the runners of a forgotten deployment, and kills any that are still alive after a few seconds."
  @spec dismiss_all([pid()]) :: :ok
  def dismiss_all(runners) do
    monitors = for runner <- runners, into: %{}, do: {Process.monitor(runner), runner}
    for runner <- runners, do: Runner.dismiss(runner)
    timer = Process.send_after(self(), :dismissed, @dismiss_ms)
    await_exits(monitors)
    _ = Process.cancel_timer(timer)
    :ok
  end

  defp await_exits(monitors) when map_size(monitors) == 0, do: :ok

  defp await_exits(monitors) do
    receive do
      {:DOWN, ref, :process, _pid, _reason} ->
        monitors |> Map.delete(ref) |> await_exits()

      :dismissed ->
        for {_, runner} <- monitors, do: Process.exit(runner, :kill)
        :ok
    end
  end

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
