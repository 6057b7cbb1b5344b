defmodule Situ.Dataset.Task do
  @moduledoc """
  Defines batch tasks. A task is a pipeline over the sessions of a dataset, with a name, a description and an options
  schema. The command line (`situ task`) and the studio list tasks, ask for their options and run them.

      defmodule Loudness do
        @behaviour Situ.Dataset.Task

        @impl true
        def task do
          %{
            name: "loudness",
            about: "the loudness of an audio stream",
            output: "Loudness",
            options: [stream: [type: :string, default: "Audio", doc: "The audio stream."]]
          }
        end

        @impl true
        def build(_p, opts) do
          opts[:stream] |> opts[:open].() |> Situ.map(&loudness/1) |> opts[:write].("Loudness")
        end
      end

  `build/2` receives the task's options and these options of every session: `open:` (a function from a stream's name
  to the stream), `has:` (a function that returns whether the stream exists), `streams:` (`[{partition,
  Situ.Store.StreamInfo}]`, without the streams of a partition that this run replaces), `folder:` (the folder of the
  session's first recording), `write:` (a function of a stream and a name that records the stream), `exporter:`
  (`nil` if `output` is `nil`) and `session:`. A task does not refer to modules of this application, so it may be in
  any application.

  An application registers its tasks in `application/0` of its `mix.exs`: `env: [dataset_tasks: [Loudness]]`.
  """
  alias Situ.{Error, Options}

  @type t :: %{
          name: String.t(),
          about: String.t(),
          output: String.t() | nil,
          options: Options.schema()
        }

  @doc "Returns the task's description."
  @callback task() :: t()
  @doc "Builds the pipeline of one session."
  @callback build(Situ.Graph.Handle.t(), keyword()) :: term()

  @doc false
  # Completes the options of `Situ.Dataset.derive/3` from the description of the task. Other pipelines have none.
  @spec complete_options(term(), keyword()) :: {:ok, keyword()} | {:error, Error.t()}
  def complete_options(module, opts) when is_atom(module) do
    if Code.ensure_loaded?(module) and function_exported?(module, :task, 0) do
      task = module.task()

      with {:ok, options} <- Options.validate(opts[:options] || [], task.options),
           do:
             {:ok,
              opts |> Keyword.put(:options, options) |> Keyword.put_new(:output, task.output)}
    else
      {:ok, opts}
    end
  end

  def complete_options(_function, opts), do: {:ok, opts}

  @doc "Returns the modules of all tasks, sorted by the tasks' names."
  @spec list_tasks() :: [module()]
  def list_tasks do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.get_env(app, :dataset_tasks, []) do
      module
    end
    |> Enum.sort_by(& &1.task().name)
  end

  @doc "Returns the module of the task with that name. Error: `:no_task`, which suggests the nearest name."
  @spec fetch_task(String.t()) :: {:ok, module()} | {:error, Error.t()}
  def fetch_task(name) do
    case Enum.find(list_tasks(), &(&1.task().name == name)) do
      nil ->
        names = Enum.map(list_tasks(), & &1.task().name)
        near = Options.nearest_name(name, names)

        {:error,
         Error.new(:no_task, "task #{inspect(name)} does not exist",
           fix:
             if(near, do: "did you mean #{near}?", else: "use one of #{Enum.join(names, ", ")}")
         )}

      module ->
        {:ok, module}
    end
  end
end
