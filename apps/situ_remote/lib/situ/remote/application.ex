defmodule Situ.Remote.Application do
  @moduledoc false
  use Application

  @impl true
  def start(_type, _args) do
    links = {Registry, keys: :duplicate, name: Situ.Remote.Links}
    children = [links | Situ.Remote.Recording.Client.child_specs()]
    Supervisor.start_link(children, strategy: :one_for_one, name: Situ.Remote.Supervisor)
  end
end
