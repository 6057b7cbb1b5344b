defmodule Situ.Infer.ModelStore do
  @moduledoc false
  # Finds the models that are too large to bundle. `bin/lib/fetch-model NAME` downloads each of
  # them once for all programs on the machine.
  #
  # They are in `SITU_MODELS` or, if that is not set, in `situ/models` of the user's cache folder
  # (`XDG_CACHE_HOME`, `~/.cache`), with one folder per model.
  #
  # | name | purpose | size | licence |
  # |---|---|---|---|
  # | `moonshine-tiny-en` | English speech to text (`Situ.Infer.Speech.Moonshine`) | 44 MB | MIT |
  # | `hibari` | English text to speech (`Situ.Infer.Speech.Hibari`) | 8 MB | Apache-2.0 |
  # | `pp-ocr-v4` | text in images (`Situ.Infer.TextReader`) | 16 MB | Apache-2.0 |
  alias Situ.Error

  @doc "Returns the folder that contains the models."
  @spec models_folder() :: Path.t()
  def models_folder,
    do: System.get_env("SITU_MODELS") || :filename.basedir(:user_cache, "situ/models")

  @doc """
  Returns the full path of a model's file. The error `:no_model_file` says how to download the model; `:bad_model` means
  that the file does not match the `SHA256SUMS` next to it. The checksum of a file is computed once, until it changes.
  """
  @spec fetch_path(String.t(), String.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def fetch_path(name, file, folder \\ models_folder()) do
    path = Path.join([folder, name, file])

    if File.regular?(path) do
      verify_checksum(path, name)
    else
      {:error,
       Error.new(:no_model_file, "the model #{name} is not on this machine",
         why: "file #{path} does not exist",
         fix: "run bin/lib/fetch-model #{name}, or set SITU_MODELS to the folder that contains it"
       )}
    end
  end

  @doc "Returns the path of a model's file in `folder`, or, if that is `nil`, the path of `fetch_path/3`."
  @spec locate_file(Path.t() | nil, String.t(), String.t()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def locate_file(nil, name, file), do: fetch_path(name, file)
  def locate_file(folder, _name, file), do: {:ok, Path.join(folder, file)}

  defp verify_checksum(path, name) do
    if expected_checksum(path) in [nil, file_checksum(path)] do
      {:ok, path}
    else
      {:error,
       Error.new(:bad_model, "the file of model #{name} does not match its checksum",
         why:
           "#{path} was truncated or changed: its checksum is not the one in SHA256SUMS next to it",
         fix: "run bin/lib/fetch-model #{name} to download it again"
       )}
    end
  end

  # Files that were copied there by hand have no checksum.
  defp expected_checksum(path) do
    with {:ok, text} <- path |> Path.dirname() |> Path.join("SHA256SUMS") |> File.read() do
      lines =
        for line <- String.split(text, "\n"), [sum, file] <- [String.split(line)], do: {file, sum}

      lines |> Map.new() |> Map.get(Path.basename(path))
    else
      {:error, _} -> nil
    end
  end

  defp file_checksum(path) do
    %{size: size, mtime: mtime, inode: inode} = File.stat!(path, time: :posix)
    key = {__MODULE__, path, size, mtime, inode}

    case :persistent_term.get(key, nil) do
      nil ->
        blocks = File.stream!(path, [], 1_048_576)
        hash = Enum.reduce(blocks, :crypto.hash_init(:sha256), &:crypto.hash_update(&2, &1))
        sum = hash |> :crypto.hash_final() |> Base.encode16(case: :lower)
        :persistent_term.put(key, sum)
        sum

      sum ->
        sum
    end
  end
end
