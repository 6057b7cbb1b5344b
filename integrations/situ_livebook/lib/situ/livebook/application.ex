defmodule Situ.Livebook.Application do
  @moduledoc false
  # Registers the smart cells with Livebook. The processes of outputs run under Kino's supervisor, which ends them when
  # their cell is evaluated again.
  use Application

  @impl true
  def start(_type, _args) do
    Kino.SmartCell.register(Situ.Livebook.RecordingCell)
    Kino.SmartCell.register(Situ.Livebook.PipelineCell)
    Supervisor.start_link([], strategy: :one_for_one, name: Situ.Livebook.Supervisor)
  end
end
