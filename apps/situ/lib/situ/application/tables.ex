defmodule Situ.Application.Tables do
  @moduledoc false
  # Owns the tables that outlive any pipeline: the telemetry handlers and the results of finished pipelines.
  use GenServer

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_), do: GenServer.start_link(__MODULE__, [])

  @impl true
  def init(_) do
    Situ.Telemetry.create_table()
    Situ.Application.PipelineResults.ensure_table()
    {:ok, nil}
  end
end
