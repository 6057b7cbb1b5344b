defmodule Situ.Experiment.TaskProvenance do
  @moduledoc false
  # Says how the partitions that tasks have made were made: the task or its file, the options, the code that the task
  # reaches, and the contents of the other partitions. It is stored with the partition, in the dataset file.
  # `list_outdated/2` compares it with the present. Layers of annotations do not count, because they change all the
  # time.
  alias Situ.Dataset
  alias Situ.Dataset.LayersPartition
  alias Situ.Experiment.{CodeVersion, InputStamp}

  @field "provenance"

  @typedoc "The module of a task, with the modules that were compiled from its file."
  @type task :: {module(), %{module() => binary()}}

  @typedoc "A partition, how to make it again, and the changes since then: `:code`, `:inputs`, or `:no_task`."
  @type entry :: %{
          session: String.t(),
          partition: String.t(),
          task: String.t(),
          options: map(),
          at: String.t() | nil,
          changes: [:code | :inputs | :no_task]
        }

  @doc """
  Returns the function for the option `provenance:` of `Situ.Dataset.derive/3`. `name` is the name of the task or the
  path of its file, `output` the name of the new partition.
  """
  @spec describe_runs(String.t(), task(), keyword(), String.t() | nil) ::
          (Dataset.Session.t() -> map())
  def describe_runs(name, task, options, output) do
    code = hash_code(task)
    json = Map.new(options, fn {key, value} -> {Atom.to_string(key), plain_value(value)} end)

    fn session ->
      %{
        "task" => name,
        "options" => json,
        "code" => code,
        "inputs" => stamp_inputs(session, output),
        "situ" => to_string(Application.spec(:situ, :vsn)),
        "at" => Situ.Time.to_iso8601(Situ.Time.now())
      }
    end
  end

  defp hash_code({module, binaries}),
    do: binaries |> CodeVersion.new() |> CodeVersion.hash_function(module, :build)

  defp plain_value(value) when is_atom(value) and value not in [true, false, nil],
    do: Atom.to_string(value)

  defp plain_value(value) when is_list(value), do: Enum.map(value, &plain_value/1)
  defp plain_value(value), do: value

  # A partition that was made from the earlier output is not an input of the new one, or both would always be outdated.
  defp stamp_inputs(session, output) do
    earlier =
      Enum.find_value(session.partitions, &(&1.name == output && &1.extra[@field]["inputs"]))

    inputs =
      for p <- session.partitions,
          p.name != output,
          not LayersPartition.layers_path?(LayersPartition.drop_version(p.path)),
          not is_map(earlier) or is_map_key(earlier, p.name) or p.extra[@field] == nil,
          do: p

    InputStamp.partition_stamps(%{session | partitions: inputs})
  end

  @doc """
  Returns the partitions of a dataset that tasks have made, oldest first. `load_task` returns the task of a name or
  file, `{:error, :unknown}` if its code cannot be compared, or another error if it does not exist.
  """
  @spec list_entries(Dataset.t(), (String.t() -> {:ok, task()} | {:error, term()})) :: [entry()]
  def list_entries(%Dataset{sessions: sessions}, load_task) do
    made =
      for session <- sessions,
          partition <- session.partitions,
          %{"task" => task, "options" => %{}} = origin when is_binary(task) <- [
            partition.extra[@field]
          ],
          do: {session, partition, origin}

    codes =
      for {_, _, %{"task" => name}} <- made,
          uniq: true,
          into: %{},
          do: {name, load_code(name, load_task)}

    made
    |> Enum.map(fn {session, partition, origin} ->
      %{
        session: session.name,
        partition: partition.name,
        task: origin["task"],
        options: origin["options"],
        at: origin["at"],
        changes:
          find_code_changes(codes[origin["task"]], origin) ++
            find_input_changes(session, partition, origin)
      }
    end)
    |> Enum.sort_by(& &1.at)
  end

  @doc "Returns the partitions that would be different if they were made again."
  @spec list_outdated(Dataset.t(), (String.t() -> {:ok, task()} | {:error, term()})) :: [entry()]
  def list_outdated(dataset, load_task),
    do: dataset |> list_entries(load_task) |> Enum.filter(&(&1.changes != []))

  defp load_code(name, load_task) do
    case load_task.(name) do
      {:ok, task} -> hash_code(task)
      {:error, :unknown} -> :unknown
      {:error, _} -> nil
    end
  end

  defp find_code_changes(nil, _origin), do: [:no_task]
  defp find_code_changes(:unknown, _origin), do: []
  defp find_code_changes(code, %{"code" => code}), do: []
  defp find_code_changes(_code, _origin), do: [:code]

  defp find_input_changes(session, partition, origin) do
    inputs = if is_map(origin["inputs"]), do: origin["inputs"], else: %{}
    stamps = stamp_inputs(session, partition.name)
    # A partition that was added since was not an input.
    if Map.take(stamps, Map.keys(inputs)) == inputs, do: [], else: [:inputs]
  end
end
