defmodule Situ.CLI.Experiment.Loading do
  @moduledoc false
  # Finds the experiment, the dataset and the run that the verbs of `situ experiment` name.
  alias Situ.CLI.SourceFile
  alias Situ.{Dataset, Error, Expression}
  alias Situ.Experiment.RunRecord

  @apps [:situ_experiment, :situ_dataset, :situ_media, :situ_infer]

  @type experiment :: %{module: module(), file: Path.t() | nil, binaries: %{module() => binary()}}

  @doc "Loads the experiment in a file, or a module of a loaded application."
  @spec load_experiment!(String.t()) :: experiment()
  def load_experiment!(name) do
    for app <- @apps, do: {:ok, _} = Application.ensure_all_started(app)
    _ = Application.load(:situ_examples)
    if Path.extname(name) in [".ex", ".exs"], do: load_file(name), else: load_module(name)
  end

  defp load_file(file) do
    binaries = Map.new(SourceFile.compile_file!(file))

    case Enum.filter(Map.keys(binaries), &experiment?/1) do
      [module] ->
        %{module: module, file: Path.expand(file), binaries: binaries}

      [] ->
        raise Error.new(:no_experiment, "#{file} defines no experiment",
                fix:
                  "define a module with `use Situ.Experiment`, parameters/0, build/3 and metrics/0"
              )

      several ->
        raise Error.new(:several_experiments, "#{file} defines several experiments",
                why: Enum.map_join(several, ", ", &inspect/1),
                fix: "put each in its own file"
              )
    end
  end

  # The name of a module must not create an atom, so only modules of applications are found.
  defp load_module(name) do
    module = Enum.find(application_modules(), fn module -> inspect(module) == name end)

    if module && experiment?(module) do
      %{module: module, file: nil, binaries: %{}}
    else
      raise Error.new(:no_experiment, "#{inspect(name)} is not an experiment",
              fix: "name a file (FILE.exs), or a module with `use Situ.Experiment`"
            )
    end
  end

  defp application_modules do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.spec(app, :modules) || [],
        do: module
  end

  defp experiment?(module) do
    Code.ensure_loaded?(module) and function_exported?(module, :build, 3) and
      function_exported?(module, :parameters, 0) and function_exported?(module, :metrics, 0)
  end

  @doc "Opens the dataset of an experiment, which must be a dataset file."
  @spec open_dataset!(Path.t()) :: Dataset.t()
  def open_dataset!(path), do: Situ.CLI.Dataset.open_dataset!(path)

  @doc "Returns a function that decides which sessions take part, from `--where`, `--session` and `--tag`."
  @spec session_filter(Dataset.t(), keyword()) :: (Dataset.Session.t() -> boolean())
  def session_filter(dataset, opts) do
    names = opts[:session] || []
    for name <- names, do: Error.unwrap!(Dataset.session(dataset, name))
    condition = opts[:where] && Expression.parse!(opts[:where])

    fn session ->
      (names == [] or session.name in names) and (opts[:tag] || []) -- session.tags == [] and
        (condition == nil or Expression.eval(condition, session_env(session)) == true)
    end
  end

  defp session_env(session),
    do: Map.merge(session.metadata, %{"name" => session.name, "tags" => session.tags})

  @doc "Returns the folder and the record of a run over a dataset; `nil` means the latest."
  @spec fetch_run!(Path.t(), String.t() | nil) :: {Path.t(), map()}
  def fetch_run!(dataset, name) do
    experiments = Error.unwrap!(RunRecord.experiments_folder(dataset))
    Error.unwrap!(RunRecord.fetch_run(experiments, name))
  end

  @doc "Parses the number of a set."
  @spec parse_set!(String.t()) :: pos_integer()
  def parse_set!(text) do
    case Integer.parse(text) do
      {n, ""} when n > 0 -> n
      _ -> throw({:usage, "a set is a number from `situ experiment show`, not #{inspect(text)}"})
    end
  end
end
