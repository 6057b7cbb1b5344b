defmodule Situ.Phoenix.Application do
  @moduledoc false
  # Situ.Phoenix.Studios     starts the studio of a route at its first request
  # Situ.Phoenix.Supervisor  holds these studios
  use Application

  @impl true
  def start(_type, _args) do
    Supervisor.start_link(
      [
        {DynamicSupervisor, name: Situ.Phoenix.StudioSupervisor, strategy: :one_for_one},
        Situ.Phoenix.Studios
      ],
      strategy: :rest_for_one,
      name: Situ.Phoenix.Supervisor
    )
  end
end
