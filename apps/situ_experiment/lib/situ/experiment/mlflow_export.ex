defmodule Situ.Experiment.MlflowExport do
  @moduledoc false
  # Writes a run in the file format of MLflow (`mlruns`): each set of parameters is a run there. Exporting the same run
  # again replaces its files.
  alias Situ.Error
  alias Situ.Experiment.{CodeVersion, RunRecord, Summary}
  alias Situ.Store.AtomicFile

  # MLflow's numbers for the status of a run, and for a local source.
  @statuses %{"running" => 1, "finished" => 3, "killed" => 5, "interrupted" => 5}
  @local 4

  @doc "Writes the rows of a run below `folder`. Error: `:not_saved`."
  @spec write_folder(Path.t(), [Summary.row()], map()) :: :ok | {:error, Error.t()}
  def write_folder(folder, rows, run) do
    id = experiment_id(run["experiment"])
    root = Path.join(Path.expand(folder), id)

    files =
      [{Path.join(root, "meta.yaml"), experiment_meta(run, id, root)}] ++
        for row <- rows, row.sessions > 0, file <- row_files(row, run, id, root), do: file

    with {:ok, _} <- Error.map_ok(files, &write_file/1), do: :ok
  end

  defp write_file({path, content}) do
    with :ok <- File.mkdir_p(Path.dirname(path)), :ok <- AtomicFile.write(path, content) do
      {:ok, path}
    else
      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "cannot write #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  # MLflow expects digits.
  defp experiment_id(name) do
    {number, _} = name |> CodeVersion.hash_term() |> String.slice(0, 14) |> Integer.parse(16)
    number |> Integer.to_string() |> String.pad_leading(18, "1")
  end

  defp experiment_meta(run, id, root) do
    time = milliseconds(run["started"])

    encode_yaml(
      artifact_location: "file://" <> root,
      creation_time: time,
      experiment_id: id,
      last_update_time: time,
      lifecycle_stage: "active",
      name: run["experiment"]
    )
  end

  defp row_files(row, run, id, root) do
    run_id = {run["run"], row.number} |> CodeVersion.hash_term() |> String.slice(0, 32)
    folder = Path.join(root, run_id)
    time = milliseconds(run["started"])

    meta =
      encode_yaml(
        artifact_uri: "file://" <> Path.join(folder, "artifacts"),
        end_time: milliseconds(run["ended"] || run["started"]),
        entry_point_name: "",
        experiment_id: id,
        lifecycle_stage: "active",
        run_id: run_id,
        run_name: "#{run["run"]} set #{row.number}",
        run_uuid: run_id,
        source_name: run["environment"]["file"] || run["module"],
        source_type: @local,
        source_version: "",
        start_time: time,
        status: @statuses[RunRecord.status(run)],
        tags: [],
        user_id: ""
      )

    entries =
      for({name, value} <- row.parameters, do: {"params/#{name}", format_parameter(value)}) ++
        for({name, value} <- metric_values(row), do: {"metrics/#{name}", "#{time} #{value} 0\n"}) ++
        for({name, value} <- run_tags(row, run), do: {"tags/#{name}", to_string(value)})

    [
      {Path.join(folder, "meta.yaml"), meta},
      {Path.join(folder, "artifacts/label.txt"), row.label}
    ] ++
      for {name, content} <- entries, do: {Path.join(folder, name), content}
  end

  defp format_parameter(value) when is_binary(value), do: value
  defp format_parameter(value), do: Situ.JSON.encode(value)

  defp metric_values(row) do
    for {metric, m} <- row.metrics,
        {name, value} <- named_values(m),
        is_number(value),
        do: {"#{metric}.#{name}", value}
  end

  defp named_values(%{values: values, interval: nil}), do: Map.to_list(values)

  defp named_values(%{values: values, interval: {low, high}}),
    do: [{"interval_low", low}, {"interval_high", high} | Map.to_list(values)]

  defp run_tags(row, run) do
    commit = run["environment"]["commit"] || %{}

    [
      {"mlflow.runName", "#{run["run"]} set #{row.number}"},
      {"situ.sessions", row.sessions},
      {"situ.run", run["run"]},
      {"situ.machines", join_machines(row)},
      {"mlflow.source.git.commit", commit["id"]}
    ]
    |> Enum.reject(fn {_, value} -> value == nil end)
  end

  defp join_machines(row) do
    case Map.get(row, :machines, []) do
      [] -> nil
      machines -> Enum.join(machines, ", ")
    end
  end

  # Strings and numbers of JSON are also YAML.
  defp encode_yaml(fields),
    do: Enum.map_join(fields, "", fn {name, value} -> "#{name}: #{Situ.JSON.encode(value)}\n" end)

  defp milliseconds(text) do
    {:ok, time} = Situ.Time.parse(text)
    div(time, 1_000_000)
  end
end
