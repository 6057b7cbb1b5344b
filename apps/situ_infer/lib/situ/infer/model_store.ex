defmodule Situ.Infer.ModelStore do
  @moduledoc """
  Models that are too large to ship: fetched once by `bin/lib/fetch-model NAME`, shared by everything on the machine.

  They lie in `SITU_MODELS`, else in `situ/models` of the person's cache folder (`XDG_CACHE_HOME`, `~/.cache`), a
  folder each.

  | name | what | size | licence |
  |---|---|---|---|
  | `moonshine-tiny-en` | English speech to text (`Situ.Infer.Speech.Moonshine`) | 44 MB | MIT |
  | `hibari` | English text to speech (`Situ.Infer.Speech.Hibari`) | 8 MB | Apache-2.0 |
  | `pp-ocr-v4` | text in pictures (`Situ.Infer.TextReader`) | 16 MB | Apache-2.0 |
  """
  alias Situ.Error

  @doc "The folder of models."
  @spec folder() :: Path.t()
  def folder, do: System.get_env("SITU_MODELS") || :filename.basedir(:user_cache, "situ/models")

  @doc """
  The full path of a model's file. Errors say how to fetch the model: `:no_model_file`, and `:bad_model` for a file that
  is not what was fetched, by the `SHA256SUMS` that lie beside it. A file is summed once, until it changes.
  """
  @spec fetch(String.t(), String.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def fetch(name, file, folder \\ folder()) do
    path = Path.join([folder, name, file])

    if File.regular?(path) do
      whole(path, name)
    else
      {:error,
       Error.new(:no_model_file, "the model #{name} is not on this machine",
         why: "there is no file #{path}",
         fix: "run bin/lib/fetch-model #{name}, or set SITU_MODELS to the folder that holds it"
       )}
    end
  end

  defp whole(path, name) do
    if expected(path) in [nil, sum(path)] do
      {:ok, path}
    else
      {:error,
       Error.new(:bad_model, "the model #{name} is not as it was fetched",
         why:
           "#{path} has another checksum than SHA256SUMS beside it: it was cut short or changed",
         fix: "run bin/lib/fetch-model #{name}, which fetches it again"
       )}
    end
  end

  # Files that somebody put there have none.
  defp expected(path) do
    with {:ok, text} <- path |> Path.dirname() |> Path.join("SHA256SUMS") |> File.read() do
      lines =
        for line <- String.split(text, "\n"), [sum, file] <- [String.split(line)], do: {file, sum}

      lines |> Map.new() |> Map.get(Path.basename(path))
    else
      {:error, _} -> nil
    end
  end

  defp sum(path) do
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
