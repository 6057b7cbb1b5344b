defmodule Situ.Application.Tables do
  @moduledoc false
  # Owns the tables that outlive any pipeline: telemetry handlers, results of pipelines that have ended.
  use GenServer

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_), do: GenServer.start_link(__MODULE__, [])

  @impl true
  def init(_) do
    Situ.Telemetry.setup()
    Situ.Application.Results.setup()
    {:ok, nil}
  end
end
