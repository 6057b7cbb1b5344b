defmodule Situ.CLI.Run.Recorder do
  @moduledoc false
  # Records the streams of a pipeline for `situ run --record FOLDER/NAME`.
  alias Situ.{Pipeline, Store}

  @doc """
  Returns a function that builds the pipeline as `build` does and records its named streams, or all streams if `all?`
  or if no stream has a name. The result of the function is `{result, path of the recording, number of streams}`.
  """
  @spec record((Pipeline.t() -> term()), Path.t(), boolean()) :: (Pipeline.t() -> term())
  def record(build, path, all?) do
    fn p ->
      result = build.(p)
      store = Store.create(p, Path.basename(path), Path.dirname(path))
      names = choose_streams(p, all?)
      for name <- names, do: p |> Pipeline.stream(name) |> Store.write(store, name)
      {result, store.path, length(names)}
    end
  end

  defp choose_streams(p, true), do: Pipeline.stream_names(p)

  defp choose_streams(p, false) do
    case Pipeline.stream_names(p, :named) do
      [] -> Pipeline.stream_names(p)
      names -> names
    end
  end
end
