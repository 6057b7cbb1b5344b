defmodule Situ.Store.Application do
  @moduledoc false
  # Supervises the indexes of segmented recordings (`Situ.Store.SegmentedRecording.Index`).
  use Application
  alias Situ.Store.SegmentedRecording.Index
  alias Situ.Store.Segments

  @impl true
  def start(_type, _args) do
    Segments.create_cache()

    Supervisor.start_link(Index.child_specs(),
      strategy: :one_for_all,
      name: Situ.Store.Supervisor
    )
  end
end
