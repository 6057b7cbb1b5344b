defmodule Situ.Store.Application do
  @moduledoc false
  # Supervises the list of open recordings, the indexes of segmented recordings
  # (`Situ.Store.SegmentedRecording.Index`), and the program for object storage (`Situ.Store.S3.Client`). Each may
  # restart without the others.
  use Application
  alias Situ.Store.{OpenRecordings, S3, Segments}
  alias Situ.Store.SegmentedRecording.Index

  @impl true
  def start(_type, _args) do
    Segments.create_cache()
    S3.Mirror.create_table()
    S3.RecentListings.create_table()

    Supervisor.start_link([OpenRecordings, index_supervisor(), S3.Client],
      strategy: :one_for_one,
      name: Situ.Store.Supervisor
    )
  end

  defp index_supervisor do
    %{
      id: Index,
      type: :supervisor,
      start: {Supervisor, :start_link, [Index.child_specs(), [strategy: :one_for_all]]}
    }
  end
end
