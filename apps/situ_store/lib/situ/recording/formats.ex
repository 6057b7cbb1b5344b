defmodule Situ.Recording.Formats do
  @moduledoc false
  # Finds the formats of files by extension, and of folders and addresses. `Situ.Recording.Format`
  # describes how formats are registered.

  @doc """
  Returns the `Situ.Recording.Format` for a file, or `nil`.

      iex> Situ.Recording.Formats.for_file("walk/imu.CSV")
      Situ.Store.Csv
      iex> Situ.Recording.Formats.for_file("notes.txt")
      nil
  """
  @spec for_file(Path.t()) :: module() | nil
  def for_file(path) do
    extension = path |> Path.extname() |> String.downcase()
    Enum.find(list_formats(), &(extension in &1.extensions()))
  end

  @doc "Returns the format of a recording that is a folder, with the folder that `path` resolves to, or `nil`."
  @spec for_folder(Path.t()) :: {module(), Path.t()} | nil
  def for_folder(path) do
    Enum.find_value(folder_formats(), fn format ->
      resolved = format.resolve(path)
      resolved && {format, resolved}
    end)
  end

  @doc "Lists the external recordings directly in this folder, or at this address."
  @spec list_recordings(Path.t()) :: [Path.t()]
  def list_recordings(folder) do
    case for_address(folder) do
      nil -> Enum.flat_map(folder_formats(), & &1.list_recordings(folder))
      format -> format.list_recordings(folder)
    end
  end

  @doc """
  Returns the format of an address (`situ://lab1/lobby`), or `nil` for a local path.

      iex> Situ.Recording.Formats.for_address("recordings/lobby")
      nil
  """
  @spec for_address(Path.t()) :: module() | nil
  def for_address(text) do
    with [scheme, _] <- String.split(text, "://", parts: 2) do
      Enum.find(address_formats(), &(scheme in &1.schemes()))
    else
      _ -> nil
    end
  end

  defp address_formats,
    do:
      Enum.filter(
        list_formats(),
        &(Code.ensure_loaded?(&1) and function_exported?(&1, :schemes, 0))
      )

  @doc """
  Expands a path like `Path.expand/1`. Addresses are returned unchanged.

      iex> Situ.Recording.Formats.expand_path("/recordings/../lobby")
      "/lobby"
  """
  @spec expand_path(Path.t()) :: Path.t()
  def expand_path(path), do: if(for_address(path), do: path, else: Path.expand(path))

  defp folder_formats,
    do:
      Enum.filter(
        list_formats(),
        &(Code.ensure_loaded?(&1) and function_exported?(&1, :resolve, 1))
      )

  @doc "Lists all known formats."
  @spec list_formats() :: [module()]
  def list_formats do
    provided =
      for {app, _, _} <- Application.loaded_applications(),
          format <- Application.get_env(app, :recording_formats, []),
          do: format

    Application.get_env(:situ_store, :formats, []) ++ provided
  end
end
