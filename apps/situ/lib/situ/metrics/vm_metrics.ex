defmodule Situ.Metrics.VmMetrics do
  @moduledoc false
  # The metrics of the VM: memory, processes and run queues.
  @behaviour Situ.Metrics

  @kinds [:total, :processes, :binary, :ets, :code, :atom]

  @impl true
  def collect_metrics do
    memory = :erlang.memory()
    {uptime_ms, _} = :erlang.statistics(:wall_clock)

    [
      gauge(
        "memory_bytes",
        "Memory of the VM by kind.",
        for(k <- @kinds, do: {[kind: "#{k}"], memory[k]})
      ),
      gauge("processes", "Erlang processes.", [{[], :erlang.system_info(:process_count)}]),
      gauge("run_queue", "Erlang processes that wait for a scheduler.", [
        {[], :erlang.statistics(:total_run_queue_lengths)}
      ]),
      gauge("uptime_seconds", "Time since the start of the VM.", [{[], uptime_ms / 1000}])
    ]
  end

  defp gauge(name, help, samples),
    do: %{name: "situ_vm_" <> name, type: :gauge, help: help, samples: samples}
end
