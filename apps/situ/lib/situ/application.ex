defmodule Situ.Application do
  @moduledoc false
  # Starts the processes that outlive any pipeline. There is no other global state.
  use Application

  @impl true
  def start(_type, _args) do
    children = [
      Situ.Clock.Wall,
      Situ.Application.Tables,
      Situ.Application.Reaper,
      Situ.Clock.registry_spec(),
      Situ.Connector.registry_spec(),
      Situ.Application.Directory,
      Situ.Application.CodeReload
    ]

    Situ.Component.LogContext.install()
    Supervisor.start_link(children, strategy: :one_for_one, name: Situ.Supervisor)
  end

  @impl true
  def stop(_state), do: Situ.Component.LogContext.uninstall()
end
