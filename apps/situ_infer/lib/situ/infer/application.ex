defmodule Situ.Infer.Application do
  @moduledoc false
  # Supervises one process, the cache of models that components share.
  use Application

  @impl true
  def start(_type, _args) do
    Supervisor.start_link([Situ.Infer.ModelCache],
      strategy: :one_for_one,
      name: Situ.Infer.Supervisor
    )
  end
end
