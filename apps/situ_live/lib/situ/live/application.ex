defmodule Situ.Live.Application do
  @moduledoc false
  # Situ.Live.Registry    process names, by server
  # Situ.Live.Connections one entry per open WebSocket, by server; used to count them and to end idle ones
  # Situ.Live.Yaws        the one embedded web server of this VM; idle until a server listens
  use Application

  @impl true
  def start(_type, _args) do
    Situ.Live.TokenRateLimit.create_table()

    children = [
      {Registry, keys: :unique, name: Situ.Live.Registry},
      {Registry, keys: :duplicate, name: Situ.Live.Connections},
      Situ.Live.Yaws
    ]

    Supervisor.start_link(children, strategy: :one_for_one, name: Situ.Live.Supervisor)
  end
end
