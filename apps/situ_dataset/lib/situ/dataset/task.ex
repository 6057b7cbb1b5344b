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

  @doc """
  Converts a saved configuration (a JSON object of the task's options) to options and checks them. Errors:
  `:unknown_option`, `:bad_option`.

      iex> schema = [rate: [type: :pos_integer, default: 10], mode: [type: {:in, [:fast, :exact]}]]
      iex> Situ.Dataset.Task.parse_options(schema, %{"mode" => "exact"})
      {:ok, [rate: 10, mode: :exact]}
      iex> {:error, error} = Situ.Dataset.Task.parse_options(schema, %{"mod" => "exact"})
      iex> error.code
      :unknown_option
  """
  @spec parse_options(Options.schema(), map()) :: {:ok, keyword()} | {:error, Error.t()}
  def parse_options(schema, config) do
    Enum.reduce_while(config, {:ok, []}, fn {name, value}, {:ok, opts} ->
      case Enum.find(schema, fn {key, _} -> Atom.to_string(key) == name end) do
        nil -> {:halt, {:error, unknown_option_error(name, schema)}}
        {key, spec} -> {:cont, {:ok, [{key, convert_value(spec[:type], value)} | opts]}}
      end
    end)
    |> case do
      {:ok, opts} -> Options.validate(opts, schema)
      error -> error
    end
  end

  defp unknown_option_error(name, schema) do
    Error.new(:unknown_option, "the task has no option #{inspect(name)}",
      fix: "use one of #{Enum.map_join(schema, ", ", fn {key, _} -> Atom.to_string(key) end)}"
    )
  end

  # JSON has no atoms, so a string selects the choice of that name. An integer is accepted for a float, 90.0 for 90,
  # and a single string for a list of strings.
  defp convert_value({:in, choices}, text) when is_binary(text),
    do: Enum.find(choices, text, &(to_string(&1) == text))

  defp convert_value({:optional, type}, value) when value != nil, do: convert_value(type, value)
  defp convert_value({:list, :string}, text) when is_binary(text), do: [text]
  defp convert_value(:float, n) when is_integer(n), do: n / 1

  defp convert_value(type, x) when is_float(x) and x == trunc(x),
    do: if(integer_type?(type), do: trunc(x), else: x)

  defp convert_value(_type, value), do: value

  defp integer_type?({:integer, _, _}), do: true
  defp integer_type?(type), do: type in [:integer, :pos_integer, :non_neg_integer, :time_ns]
end
