defmodule Situ.Bench.Empty do
  @moduledoc false
  # Creates, runs and disposes of a pipeline, without components and with one that completes
  # immediately.
  alias Situ.Pipeline

  def tests, do: [{"empty", &empty(max(round(1_000 * &1), 1))}]

  defp empty(n) do
    nothing = time(n, fn _p -> :ok end)
    one = time(n, fn p -> Situ.source(p, Situ.Component.Empty) end)
    [{"pipeline_create_run_dispose", nothing, "ms"}, {"pipeline_one_component", one, "ms"}]
  end

  defp time(n, build) do
    before = :erlang.system_info(:process_count)
    {us, _} = :timer.tc(fn -> for _ <- 1..n, do: {:ok, _} = Pipeline.run(build) end)
    if :erlang.system_info(:process_count) > before + 10, do: raise("processes are left")
    us / n / 1_000
  end
end
