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

  @doc "The full path of a model's file; an error that says how to fetch the model when it is not there."
  @spec fetch(String.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def fetch(name, file) do
    path = Path.join([folder(), name, file])

    if File.regular?(path) do
      {:ok, path}
    else
      {:error,
       Error.new(:no_model_file, "the model #{name} is not on this machine",
         why: "there is no file #{path}",
         fix: "run bin/lib/fetch-model #{name}, or set SITU_MODELS to the folder that holds it"
       )}
    end
  end
end
