defmodule Situ.Application do
  @moduledoc false
  # Creates the tables that outlive any pipeline. Nothing else is global.
  use Application

  @impl true
  def start(_type, _args) do
    Situ.Telemetry.setup()
    Situ.Pipeline.Archive.setup()

    children = [
      Situ.Pipeline.Reaper,
      Situ.Clock.registry(),
      Situ.Connector.registry(),
      Situ.Tap.registry()
    ]

    Supervisor.start_link(children, strategy: :one_for_one, name: Situ.Supervisor)
  end
end
