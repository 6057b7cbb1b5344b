defmodule Situ.Store.Formats do
  @moduledoc """
  The readers of foreign files, found by a file's extension.

  First come those named in the configuration,

      config :situ_store, readers: [MyFormat]

  then those that a loaded application brings (`env: [store_readers: [MyFormat]]` in `application/0` of its
  `mix.exs`). This application brings CSV; `situ_media` brings WAV and everything FFmpeg reads.

      iex> Situ.Store.Formats.for_file("walk/imu.CSV")
      Situ.Store.Csv
      iex> Situ.Store.Formats.for_file("notes.txt")
      nil
  """

  @doc "The `Situ.Store.Reader` for a file, or `nil`."
  @spec for_file(Path.t()) :: module() | nil
  def for_file(path) do
    extension = path |> Path.extname() |> String.downcase()
    Enum.find(all(), &(extension in &1.extensions()))
  end

  @doc "The reader whose recordings are folders and what `path` means to it, or `nil`."
  @spec for_folder(Path.t()) :: {module(), Path.t()} | nil
  def for_folder(path) do
    Enum.find_value(of_folders(), fn reader ->
      resolved = reader.resolve(path)
      resolved && {reader, resolved}
    end)
  end

  @doc "The foreign recordings that lie in this very folder, or at this address."
  @spec within(Path.t()) :: [Path.t()]
  def within(folder) do
    case for_address(folder) do
      nil -> Enum.flat_map(of_folders(), & &1.within(folder))
      reader -> reader.within(folder)
    end
  end

  @doc """
  The reader of an address (`situ://lab1/lobby`), or `nil`: a path of this machine has none.

      iex> Situ.Store.Formats.for_address("recordings/lobby")
      nil
  """
  @spec for_address(Path.t()) :: module() | nil
  def for_address(text) do
    with [scheme, _] <- String.split(text, "://", parts: 2) do
      Enum.find(of_addresses(), &(scheme in &1.schemes()))
    else
      _ -> nil
    end
  end

  defp of_addresses,
    do: Enum.filter(all(), &(Code.ensure_loaded?(&1) and function_exported?(&1, :schemes, 0)))

  @doc """
  A path from the root on, as `Path.expand/1` has it; an address stays as it is.

      iex> Situ.Store.Formats.expand("/recordings/../lobby")
      "/lobby"
  """
  @spec expand(Path.t()) :: Path.t()
  def expand(path), do: if(for_address(path), do: path, else: Path.expand(path))

  defp of_folders,
    do: Enum.filter(all(), &(Code.ensure_loaded?(&1) and function_exported?(&1, :resolve, 1)))

  @doc "Every known reader."
  @spec all() :: [module()]
  def all do
    brought =
      for {app, _, _} <- Application.loaded_applications(),
          reader <- Application.get_env(app, :store_readers, []),
          do: reader

    Application.get_env(:situ_store, :readers, []) ++ brought
  end
end
