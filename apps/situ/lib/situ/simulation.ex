defmodule Situ.Simulation do
  @moduledoc false
  alias Situ.Simulation.{Choices, Scheduler}

  @defaults [seed: 0, choices: nil, kill: [], max_steps: 100_000, trace: true]

  def run(fun, opts \\ []) do
    opts = Keyword.merge(@defaults, opts)
    run_schedule(fun, Choices.new(opts[:choices] || opts[:seed]), opts)
  end

  defp run_schedule(fun, choices, opts) do
    {pid, monitor} =
      spawn_monitor(fn -> exit({:simulated, Scheduler.run(fun, choices, opts)}) end)

    receive do
      {:DOWN, ^monitor, :process, ^pid, {:simulated, result}} -> result
      {:DOWN, ^monitor, :process, ^pid, reason} -> exit(reason)
    end
  end
end
