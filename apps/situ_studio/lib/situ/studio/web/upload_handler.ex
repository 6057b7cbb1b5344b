defmodule Situ.Studio.Web.UploadHandler do
  @moduledoc false
  # Handles the connection that uploads a recording. The page first sends the name and the files as JSON, and receives
  # `{"received": 0}`. It then sends the bytes in binary frames and receives the new total after each, so that it can
  # limit the frames in flight. At the end it receives `{"done": "path/of/the/page"}`, or at any time `{"error": text}`.
  @behaviour Situ.Live.SocketHandler

  alias Situ.{Error, JSON}
  alias Situ.Studio.{Catalog, Upload}
  alias Situ.Studio.Web.Paths

  @impl true
  def init(request, studio) do
    case Catalog.writable_folder(studio) do
      {:ok, folder} when request.role != :viewer ->
        {:ok, %{studio: studio, folder: folder, upload: nil}}

      _ ->
        {:error, "this page may not add recordings"}
    end
  end

  @impl true
  def handle_in({text, opcode: :text}, %{upload: nil} = state) do
    with {:ok, %{"name" => name, "files" => files}} when is_binary(name) and is_list(files) <-
           JSON.decode(text),
         {:ok, files} <- parse_files(files),
         {:ok, upload} <- Upload.start(state.folder, name, files) do
      report_progress(upload, state)
    else
      {:error, %Error{} = error} -> refuse_upload(error, state)
      _ -> {:stop, {:shutdown, :bad_request}, state}
    end
  end

  def handle_in({bytes, opcode: :binary}, %{upload: %Upload{} = upload} = state) do
    case Upload.write(upload, bytes) do
      {:ok, upload} -> report_progress(upload, state)
      {:error, error} -> refuse_upload(error, state)
    end
  end

  def handle_in(_frame, state), do: {:stop, {:shutdown, :bad_request}, state}

  # If the connection ends before the upload is complete, what arrived is deleted.
  @impl true
  def terminate(_reason, %{upload: %Upload{} = upload}), do: Upload.discard(upload)
  def terminate(_reason, _state), do: :ok

  defp parse_files(files) do
    parsed =
      for %{"path" => path, "size" => size} when is_binary(path) and is_integer(size) <- files,
          do: {path, size}

    if length(parsed) == length(files), do: {:ok, parsed}, else: :error
  end

  defp report_progress(upload, state) do
    state = %{state | upload: upload}
    progress = text_frame(%{received: upload.received})

    if Upload.complete?(upload),
      do: finish_upload(state, progress),
      else: {:push, progress, state}
  end

  defp finish_upload(%{upload: upload} = state, progress) do
    case Upload.finish(upload) do
      {:ok, name} ->
        Catalog.invalidate_recordings(state.studio)
        done = text_frame(%{done: page_path(state.studio, name)})
        {:push, [progress, done], %{state | upload: nil}}

      {:error, error} ->
        refuse_upload(error, state)
    end
  end

  # A folder of several recordings has no page.
  defp page_path(studio, name) do
    case Catalog.fetch_item(studio, name) do
      {:ok, item} -> Paths.item_path(item)
      {:error, _} -> ""
    end
  end

  defp refuse_upload(error, state) do
    if state.upload, do: Upload.discard(state.upload)
    {:push, text_frame(%{error: Exception.message(error)}), %{state | upload: nil}}
  end

  defp text_frame(map), do: {:text, JSON.encode(map)}
end
