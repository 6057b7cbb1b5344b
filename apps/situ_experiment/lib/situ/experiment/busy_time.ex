defmodule Situ.Experiment.BusyTime do
  @moduledoc false
  # The computing time of a pipeline: the time that its components spent with messages. Unlike the CPU time of the VM,
  # it does not include other pipelines that are running at the same time.
  alias Situ.Diagnostics.Snapshot

  @doc "Returns the sum over all components in seconds."
  @spec total_seconds(Snapshot.t() | nil) :: float()
  def total_seconds(nil), do: 0.0

  def total_seconds(%Snapshot{} = snapshot) do
    busy = for edge <- snapshot.edges, edge.kind == :process, do: edge.busy
    Enum.sum(busy) / 1.0e9
  end
end
