defmodule Situ.Infer.Application do
  @moduledoc false
  # One process: the table of models shared between components.
  use Application

  @impl true
  def start(_type, _args) do
    Supervisor.start_link([Situ.Infer.Shelf],
      strategy: :one_for_one,
      name: Situ.Infer.Supervisor
    )
  end
end
