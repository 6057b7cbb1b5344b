defmodule Situ.Store.Locator do
  @moduledoc false
  # Finds the files of a recording and the reader for their format.
  alias Situ.Error
  alias Situ.Recording.Formats

  alias Situ.Store.{
    Folder,
    MovePlan,
    NativeErrors,
    NativeFormat,
    Replacement,
    SegmentedRecording,
    SegmentRenaming,
    Segments
  }

  @doc "Returns the full path of a recording and its reader; `reader` overrides the reader for the format."
  @spec find_recording(Path.t(), module() | nil) ::
          {:ok, Path.t(), module()} | {:error, Error.t()}
  def find_recording(path, reader) do
    case Formats.for_address(path) do
      nil -> find_here(Path.expand(path), reader)
      module -> find_address(path, module, reader)
    end
  end

  defp find_address(address, module, reader) do
    if Code.ensure_loaded?(module) and function_exported?(module, :locate, 1),
      do: with({:ok, path} <- module.locate(address), do: find_here(path, reader)),
      else: {:ok, address, reader || module}
  end

  defp find_here(path, reader) do
    folder = Folder.resolve_store(path)

    cond do
      plan = SegmentRenaming.find_interrupted(path) ->
        {:error, SegmentRenaming.interrupted_error(plan)}

      plan = MovePlan.find_interrupted(path) ->
        {:error, MovePlan.interrupted_error(plan)}

      reader == nil and Segments.segmented?(path) ->
        {:ok, path, SegmentedRecording}

      folder && Folder.store_folder?(folder) ->
        {:ok, folder, reader || NativeFormat}

      reader != nil ->
        {:ok, path, reader}

      File.regular?(path) ->
        find_reader(path)

      true ->
        find_folder(path, folder)
    end
  end

  # A versioned folder that has lost its index and data files is still opened as a store, so that the error is specific.
  defp find_folder(path, folder) do
    case {Formats.for_folder(path), folder} do
      {{module, path}, _} -> {:ok, path, module}
      {nil, nil} -> {:error, no_store_error(path)}
      {nil, folder} -> {:ok, folder, NativeFormat}
    end
  end

  defp no_store_error(path) do
    case Replacement.find_interrupted(path) do
      nil -> NativeErrors.to_error(:no_store, path)
      folder -> NativeErrors.to_error(:compaction_interrupted, folder)
    end
  end

  defp find_reader(path) do
    with nil <- Formats.for_file(path), nil <- Formats.for_content(path) do
      known = Formats.list_formats() |> Enum.flat_map(& &1.extensions()) |> Enum.join(", ")

      {:error,
       Error.new(:unknown_format, "no reader for #{path}",
         why: "there are readers for #{known} and for store folders",
         fix:
           "`situ formats` lists what Situ reads and writes; a program can name a `reader: Module`"
       )}
    else
      module -> {:ok, path, module}
    end
  end
end
