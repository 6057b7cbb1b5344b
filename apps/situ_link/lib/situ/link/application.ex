defmodule Situ.Link.Application do
  @moduledoc false
  use Application

  @impl true
  def start(_type, _args) do
    links = {Registry, keys: :duplicate, name: Situ.Link.Registry}
    children = [links | Situ.Link.Recording.Client.child_specs()]
    Supervisor.start_link(children, strategy: :one_for_one, name: Situ.Link.Supervisor)
  end
end
