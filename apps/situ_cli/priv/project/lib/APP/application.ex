defmodule {{Module}}.Application do
  @moduledoc false
  # Supervises the pipelines that the configuration lists. `situ run` and the tests start their own.
  use Application

  @impl true
  def start(_type, _args) do
    children = Application.get_env(:{{app}}, :children, [])
    Supervisor.start_link(children, strategy: :one_for_one, name: {{Module}}.Supervisor)
  end
end
