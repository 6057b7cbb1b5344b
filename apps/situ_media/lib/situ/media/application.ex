defmodule Situ.Media.Application do
  @moduledoc false
  # Supervises the processes that read media files opened as recordings. All other processes here end with their owners.
  use Application

  @impl true
  def start(_type, _args) do
    Supervisor.start_link(Situ.Media.Recording.Servers.child_specs(),
      strategy: :one_for_all,
      name: Situ.Media.Supervisor
    )
  end
end
