defmodule Situ.Experiment.Reproduction do
  @moduledoc false
  # Computes results of a run again, without any cache, and compares the streams with the recorded ones.
  alias Situ.{Dataset, Error, Store}

  alias Situ.Experiment.{
    CodeVersion,
    Context,
    InputStamp,
    Parameters,
    Provenance,
    StreamDiff,
    Summary,
    Trial
  }

  @type outcome :: %{
          session: String.t(),
          differences: [StreamDiff.difference()],
          error: Error.t() | nil
        }
  @type report :: %{set: pos_integer(), changes: [String.t()], outcomes: [outcome()]}

  @doc """
  Computes a set of a run again for all its sessions. `changes` names parts of the environment that have changed since:
  `code`, `commit`, `models`, `versions`, `machine`, or `inputs`.
  """
  @spec reproduce_set(module(), Dataset.t(), {Path.t(), map()}, keyword()) ::
          {:ok, report()} | {:error, Error.t()}
  def reproduce_set(module, dataset, {folder, run}, opts) do
    number = opts[:set]

    with {:ok, results} <- Summary.fetch_results(folder, run, number),
         {:ok, set} <- find_set(module, run, number) do
      temporary =
        Path.join(folder, "reproduce-#{System.pid()}-#{System.unique_integer([:positive])}")

      code = CodeVersion.new(opts[:binaries] || %{})
      context = %Context{module: module, folder: temporary, code: code}

      try do
        outcomes =
          for {session, result} <- Enum.sort(results) do
            outcome =
              reproduce_session(
                context,
                dataset,
                {session, set},
                Path.join(folder, result["output"] || "")
              )

            if fun = opts[:progress], do: fun.(session)
            outcome
          end

        now = Provenance.describe_environment(context, opts[:file])
        inputs = changed_inputs(dataset, run, Map.keys(results))

        {:ok,
         %{
           set: number,
           changes: Provenance.list_changes(run["environment"], now) ++ inputs,
           outcomes: outcomes
         }}
      after
        File.rm_rf!(temporary)
      end
    end
  end

  defp find_set(module, run, number) do
    json = Enum.find(run["sets"], &(&1["number"] == number))["parameters"]

    with {:ok, sets} <- Parameters.list_sets(module.parameters()) do
      case Enum.find(sets, &(&1.json == json)) do
        nil ->
          {:error,
           Error.new(:no_set, "the experiment no longer has the parameters of set #{number}",
             why: "the run used #{Situ.JSON.encode(json)}",
             fix: "add them to parameters/0, or use the file of that commit"
           )}

        set ->
          {:ok, set}
      end
    end
  end

  defp reproduce_session(context, dataset, {name, set}, recorded) do
    with {:ok, session} <- Dataset.session(dataset, name),
         stamp = InputStamp.session_stamp(session, InputStamp.partition_stamps(session)),
         trial = Trial.new(context, session, set, stamp),
         {:ok, path, _} <-
           Trial.run_pipeline(trial, context, Path.join(context.folder, "outputs")),
         {:ok, before} <- Store.open(recorded),
         {:ok, now} <- Store.open(path) do
      %{session: name, differences: StreamDiff.list_differences(before, now), error: nil}
    else
      {:error, error} -> %{session: name, differences: [], error: error}
    end
  end

  defp changed_inputs(dataset, run, names) do
    changed? =
      Enum.any?(names, fn name ->
        case Dataset.session(dataset, name) do
          {:ok, session} -> InputStamp.partition_stamps(session) != run["inputs"][name]
          {:error, _} -> true
        end
      end)

    if changed?, do: ["inputs"], else: []
  end
end
