defmodule Situ.Bench.Empty do
  @moduledoc false
  # Creates, runs and disposes of a pipeline: without components, with one that completes
  # immediately, and with a source of one message and a sink (the reference's `empty`).
  alias Situ.Pipeline

  def tests, do: [{"empty", &empty(max(round(1_000 * &1), 1))}]

  def empty(n) do
    received = :counters.new(1, [])
    add = fn _ -> :counters.add(received, 1, 1) end

    metrics =
      time("pipeline_create_run_dispose", n, fn _p -> :ok end) ++
        time("pipeline_one_component", n, &Situ.source(&1, Situ.Component.Empty)) ++
        time(
          "pipeline_source_sink",
          n,
          &(&1 |> Situ.from_enumerable([1], every: 1) |> Situ.each(add))
        )

    if :counters.get(received, 1) != n,
      do: raise("#{:counters.get(received, 1)} of #{n} messages")

    metrics
  end

  defp time(metric, n, build) do
    before = :erlang.system_info(:process_count)
    cpu = Situ.Bench.cpu_us()
    {us, _} = :timer.tc(fn -> for _ <- 1..n, do: {:ok, _} = Pipeline.run(build) end)
    used = Situ.Bench.cpu_us() - cpu
    await_process_count(before + 10, 100)
    [{metric, us / n / 1_000, "ms"}, {metric <> "_cpu", used / n / 1_000, "ms"}]
  end

  # Processes of the last pipelines may still be ending.
  defp await_process_count(most, tries) do
    count = :erlang.system_info(:process_count)

    cond do
      count <= most ->
        :ok

      tries == 0 ->
        raise("#{count} processes are left")

      true ->
        Process.sleep(20)
        await_process_count(most, tries - 1)
    end
  end
end
