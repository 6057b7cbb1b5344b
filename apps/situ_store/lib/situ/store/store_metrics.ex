defmodule Situ.Store.StoreMetrics do
  @moduledoc false
  # The metrics of the recordings that pipelines of this node are writing, for `Situ.Metrics`.
  @behaviour Situ.Metrics

  alias Situ.Store.OpenRecordings

  @impl true
  def collect_metrics, do: build_metrics(OpenRecordings.list_recordings())

  @doc "Builds the metrics from the names of recordings and their bytes."
  @spec build_metrics(%{String.t() => non_neg_integer()}) :: [Situ.Metrics.metric()]
  def build_metrics(recordings) do
    [
      %{
        name: "situ_store_written_bytes_total",
        type: :counter,
        help: "Bytes of a recording that is being written, with its earlier segments.",
        samples: for({name, bytes} <- Enum.sort(recordings), do: {[store: name], bytes})
      }
    ]
  end
end
