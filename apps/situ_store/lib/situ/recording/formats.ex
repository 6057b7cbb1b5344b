defmodule Situ.Recording.Formats do
  @moduledoc false
  # Finds the formats of files by extension, and of folders and addresses. `Situ.Recording.Format`
  # describes how formats are registered.

  # See docs/adr/0198-one-registry-of-file-kinds.md.
  alias Situ.Recording.FileKind

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

  # The longest signature ends at this position.
  @first_bytes 512

  @doc """
  Returns the format of a file by its first bytes, or `nil`: for files whose extension says nothing.
  """
  @spec for_content(Path.t()) :: module() | nil
  def for_content(path) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]),
         result = :file.read(file, @first_bytes),
         :ok <- :file.close(file),
         {:ok, bytes} <- result do
      Enum.find_value(list_kinds(), &(&1.open && FileKind.signed?(&1, bytes) && &1.open))
    else
      _ -> nil
    end
  end

  @doc """
  Lists all kinds of files that Situ reads or writes, by name.

      iex> csv = Enum.find(Situ.Recording.Formats.list_kinds(), &(&1.name == :csv))
      iex> {csv.open, ".tsv" in csv.extensions}
      {Situ.Store.Csv, true}
  """
  @spec list_kinds() :: [FileKind.t()]
  def list_kinds do
    declared = for module <- list_env(:file_kinds), kind <- module.kinds(), do: kind

    (Enum.flat_map(list_formats(), &format_kinds/1) ++ declared)
    |> Enum.group_by(& &1.name)
    |> Enum.map(fn {_name, kinds} -> Enum.reduce(kinds, &FileKind.join(&2, &1)) end)
    |> Enum.sort_by(& &1.name)
  end

  defp format_kinds(format) do
    cond do
      Code.ensure_loaded?(format) and function_exported?(format, :kinds, 0) -> format.kinds()
      format.extensions() == [] -> []
      true -> [plain_kind(format)]
    end
  end

  defp plain_kind(format),
    do: %FileKind{
      name: format,
      title: inspect(format),
      extensions: format.extensions(),
      open: format
    }

  @doc "Lists all known formats."
  @spec list_formats() :: [module()]
  def list_formats do
    Application.get_env(:situ_store, :formats, []) ++ list_env(:recording_formats)
  end

  defp list_env(key) do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.get_env(app, key, []),
        do: module
  end
end
