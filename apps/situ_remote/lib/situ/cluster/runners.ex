defmodule Situ.Cluster.Runners do
  @moduledoc false
  # Asks or ends several runners at once, on any nodes: one that does not answer holds up none of the others.
  alias Situ.Cluster.Runner

  @dismiss_ms 5_000

  @doc "The state of each within `timeout` ms; `%{}` of one that does not answer."
  @spec infos([pid()], timeout()) :: [map()]
  def infos(runners, timeout) do
    asked = for runner <- runners, do: :gen_server.send_request(runner, :info)
    till = now() + timeout

    for request <- asked,
        do: answer(:gen_server.receive_response(request, max(till - now(), 0)))
  end

  defp answer({:reply, info}), do: info
  defp answer(_timeout_or_error), do: %{}

  @doc "Ends runners of a deployment that was forgotten; one that does not end by itself is killed."
  @spec dismiss([pid()]) :: :ok
  def dismiss(runners) do
    monitors = for runner <- runners, into: %{}, do: {Process.monitor(runner), runner}
    for runner <- runners, do: Runner.dismiss(runner)
    timer = Process.send_after(self(), :dismissed, @dismiss_ms)
    wait_for(monitors)
    _ = Process.cancel_timer(timer)
    :ok
  end

  defp wait_for(monitors) when map_size(monitors) == 0, do: :ok

  defp wait_for(monitors) do
    receive do
      {:DOWN, ref, :process, _pid, _reason} ->
        monitors |> Map.delete(ref) |> wait_for()

      :dismissed ->
        for {_, runner} <- monitors, do: Process.exit(runner, :kill)
        :ok
    end
  end

  defp now, do: System.monotonic_time(:millisecond)
end
