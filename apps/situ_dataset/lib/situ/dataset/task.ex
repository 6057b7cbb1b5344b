defmodule Situ.Dataset.Task do
  @moduledoc """
  A batch task: a pipeline over the sessions of a dataset that has a name, a description and an options schema, so
  that the command line (`situ task`) and the studio can list it, ask for its options and run it.

      defmodule Loudness do
        @behaviour Situ.Dataset.Task

        @impl true
        def task do
          %{
            name: "loudness",
            about: "the loudness of a sound stream",
            output: "Loudness",
            options: [stream: [type: :string, default: "Audio", doc: "The sound."]]
          }
        end

        @impl true
        def build(_p, opts) do
          opts[:stream] |> opts[:open].() |> Situ.map(&loudness/1) |> opts[:write].("Loudness")
        end
      end

  `build/2` gets the task's own options and those of every session: `open:` (a function from a stream's name to the
  stream), `has:` (whether there is one), `streams:` (`[{partition, Situ.Store.StreamInfo}]`,
  without those of a partition that this run replaces), `folder:` (where the
  session's first recording lies), `write:` (a function of a stream and a name, that records it), `exporter:` (`nil`
  when `output` is), `session:`. It names nothing of this application, so a task may live in any.

  An application brings its tasks in `application/0` of its `mix.exs`: `env: [dataset_tasks: [Loudness]]`.
  """
  alias Situ.{Error, Options}

  @type t :: %{
          name: String.t(),
          about: String.t(),
          output: String.t() | nil,
          options: Options.schema()
        }

  @doc "The task's description."
  @callback task() :: t()
  @doc "Builds the pipeline of one session."
  @callback build(Situ.Graph.Handle.t(), keyword()) :: term()

  @doc "The modules of all tasks, by name."
  @spec all() :: [module()]
  def all do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.get_env(app, :dataset_tasks, []) do
      module
    end
    |> Enum.sort_by(& &1.task().name)
  end

  @doc "The task of that name. Error: `:no_task`, with the nearest name."
  @spec fetch(String.t()) :: {:ok, module()} | {:error, Error.t()}
  def fetch(name) do
    case Enum.find(all(), &(&1.task().name == name)) do
      nil ->
        names = Enum.map(all(), & &1.task().name)
        near = Options.nearest(name, names)

        {:error,
         Error.new(:no_task, "there is no task #{inspect(name)}",
           fix: if(near, do: "did you mean #{near}?", else: "there are #{Enum.join(names, ", ")}")
         )}

      module ->
        {:ok, module}
    end
  end

  @doc """
  A saved configuration (a JSON object of the task's options) as options, checked. Errors: `:unknown_option`,
  `:bad_option`.

      iex> schema = [rate: [type: :pos_integer, default: 10], mode: [type: {:in, [:fast, :exact]}]]
      iex> Situ.Dataset.Task.options(schema, %{"mode" => "exact"})
      {:ok, [rate: 10, mode: :exact]}
      iex> {:error, error} = Situ.Dataset.Task.options(schema, %{"mod" => "exact"})
      iex> error.code
      :unknown_option
  """
  @spec options(Options.schema(), map()) :: {:ok, keyword()} | {:error, Error.t()}
  def options(schema, config) do
    Enum.reduce_while(config, {:ok, []}, fn {name, value}, {:ok, opts} ->
      case Enum.find(schema, fn {key, _} -> Atom.to_string(key) == name end) do
        nil -> {:halt, {:error, unknown(name, schema)}}
        {key, spec} -> {:cont, {:ok, [{key, read(spec[:type], value)} | opts]}}
      end
    end)
    |> case do
      {:ok, opts} -> Options.validate(opts, schema)
      error -> error
    end
  end

  defp unknown(name, schema) do
    Error.new(:unknown_option, "the task has no option #{inspect(name)}",
      fix: "it has #{Enum.map_join(schema, ", ", fn {key, _} -> Atom.to_string(key) end)}"
    )
  end

  # JSON has no atoms: of a choice the one that is so called is meant. A whole number does for a float, 90.0 for
  # 90, and one text for a list of them.
  defp read({:in, choices}, text) when is_binary(text),
    do: Enum.find(choices, text, &(to_string(&1) == text))

  defp read({:optional, type}, value) when value != nil, do: read(type, value)
  defp read({:list, :string}, text) when is_binary(text), do: [text]
  defp read(:float, n) when is_integer(n), do: n / 1

  defp read(type, x) when is_float(x) and x == trunc(x),
    do: if(whole?(type), do: trunc(x), else: x)

  defp read(_type, value), do: value

  defp whole?({:integer, _, _}), do: true
  defp whole?(type), do: type in [:integer, :pos_integer, :non_neg_integer, :time_ns]
end
