defmodule Situ.Media.Application do
  @moduledoc false
  # Supervises the processes that read media files opened as recordings. All other processes here end with their owners.
  use Application

  @impl true
  def start(_type, _args) do
    servers = %{
      id: :servers,
      type: :supervisor,
      start:
        {Supervisor, :start_link,
         [Situ.Media.Recording.Servers.child_specs(), [strategy: :one_for_all]]}
    }

    Supervisor.start_link([servers, Situ.Media.SmallCopies],
      strategy: :one_for_one,
      name: Situ.Media.Supervisor
    )
  end
end
