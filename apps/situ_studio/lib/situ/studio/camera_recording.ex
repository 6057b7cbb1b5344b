defmodule Situ.Studio.CameraRecording do
  @moduledoc false
  # Records the camera and the microphone of a browser into the studio's folder, for people who have no recording yet.
  # The recording ends when its sensor page is closed.
  use Situ.Pipeline

  alias Situ.{Error, Store}
  alias Situ.Studio.{Catalog, Sensor}

  @name "Camera"

  @doc """
  Starts a recording. Returns the name of the sensor page that it waits for, and the id of the recording. Errors: those
  of creating a store.
  """
  @spec start_recording(studio :: String.t(), Path.t()) ::
          {:ok, %{page: String.t(), recording: String.t()}} | {:error, Error.t()}
  def start_recording(studio, folder) do
    page = "camera-#{System.unique_integer([:positive])}"
    child = {__MODULE__, folder: folder, page: page, pipeline: [name: @name]}
    child = Supervisor.child_spec(child, restart: :temporary)

    case DynamicSupervisor.start_child(Catalog.watch_supervisor(studio), child) do
      {:ok, _pid} ->
        {:ok, %{page: page, recording: newest_recording(folder)}}

      {:error, %Error{} = error} ->
        {:error, error}

      {:error, reason} ->
        {:error, Error.new(:not_started, "the recording did not start", why: inspect(reason))}
    end
  end

  defp newest_recording(folder),
    do: @name |> Store.Folder.newest_version(folder) |> Path.relative_to(folder)

  @impl true
  def build(p, opts) do
    sensor = Sensor.open(p, page: opts[:page], end_with_page: true)
    store = Store.create(p, @name, opts[:folder])
    Store.write(sensor.video, store, "Camera.Pictures")
    Store.write(sensor.audio, store, "Camera.Sound")
    store
  end
end
