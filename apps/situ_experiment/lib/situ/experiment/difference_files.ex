defmodule Situ.Experiment.DifferenceFiles do
  @moduledoc false
  # The recordings of differences (`Situ.Experiment.Difference`) in an experiment's folder. One is written when somebody
  # looks at it, and used again by everybody who looks at the same outputs.
  alias Situ.Dataset.{OpenSession, Session}
  alias Situ.Error
  alias Situ.Experiment.{CodeVersion, Difference, Summary}
  alias Situ.Store

  @typedoc "A set of a run: the folder of the experiment, the run, and the number of the set."
  @type set :: {folder :: Path.t(), run :: map(), number :: pos_integer()}

  @doc """
  Returns the recording of the differences of a set from the baseline in a session, after writing it if necessary.
  Without a baseline, or if both have the same output, the set is compared with the truth. Returns also the name under
  which `fetch_recording/2` finds it. With `read_only: true`, nothing is written. Errors: `:no_output`, `:read_only`,
  and the errors of `Difference.write_recording/4`.
  """
  @spec ensure_recording(Session.t(), set(), set() | nil, read_only: boolean()) ::
          {:ok, %{path: Path.t(), name: String.t()}} | {:error, Error.t()}
  def ensure_recording(%Session{} = session, {folder, run, _} = set, baseline, opts \\ []) do
    with {:ok, output} <- fetch_output(set, session.name),
         {:ok, other} <- fetch_baseline(baseline, session.name) do
      other = if other == output, do: nil, else: other
      title = "#{session.name}: #{describe_sets(set, other && baseline)}"
      outputs = %{run: output, baseline: other}
      hash = CodeVersion.hash_term({outputs, run["metrics"], session.partitions, title})
      key = String.slice(hash, 0, 32)
      path = Path.join(differences_folder(folder), key)

      write = fn ->
        if opts[:read_only],
          do: {:error, read_only_error()},
          else: write_recording(path, session, outputs, {run["metrics"], title})
      end

      with {:ok, recording} <- find_or_write(path, write),
           do: {:ok, %{path: recording, name: "#{Path.basename(folder)}:#{key}"}}
    end
  end

  defp describe_sets({_, _, number}, nil), do: "set #{number} and the truth"

  defp describe_sets({_, run, number}, {_, other, baseline}) do
    if run["run"] == other["run"],
      do: "set #{number} and the baseline, set #{baseline}",
      else: "set #{number} of run #{run["run"]} and the baseline of run #{other["run"]}"
  end

  defp fetch_baseline(nil, _session), do: {:ok, nil}
  defp fetch_baseline(baseline, session), do: fetch_output(baseline, session)

  defp fetch_output({folder, run, number}, session) do
    with {:ok, results} <- Summary.fetch_results(folder, run, number),
         %{"status" => "done", "output" => output} <- results[session],
         path = Path.join(folder, output),
         true <- File.dir?(path) do
      {:ok, path}
    else
      {:error, error} ->
        {:error, error}

      _ ->
        {:error,
         Error.new(
           :no_output,
           "set #{number} of run #{run["run"]} has no output for session #{session}",
           why: "it has failed or has not run there, or its recording was deleted",
           fix: "run the experiment again"
         )}
    end
  end

  defp find_or_write(path, write) do
    case Store.newest(Path.basename(path), Path.dirname(path)) do
      nil -> write.()
      recording -> {:ok, recording}
    end
  end

  # Two programs may write the same recording at the same time; both versions are complete and equal.
  defp write_recording(path, session, outputs, metrics) do
    case File.mkdir_p(Path.dirname(path)) do
      :ok ->
        Difference.write_recording(path, OpenSession.open(session), outputs, metrics)

      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "cannot write #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "check the permissions of the folder"
         )}
    end
  end

  defp read_only_error do
    Error.new(:read_only, "the differences of these sets have not been recorded yet",
      why: "this studio is read-only",
      fix: "open them once in a studio that may write"
    )
  end

  @doc "Returns the recording with that name in the folder of all experiments over a dataset."
  @spec fetch_recording(Path.t(), String.t()) :: {:ok, Path.t()} | :error
  def fetch_recording(experiments, name) do
    with [_, experiment, key] <- Regex.run(~r/\A(\w+):([0-9a-f]{32})\z/, name),
         path when path != nil <-
           Store.newest(key, differences_folder(Path.join(experiments, experiment))) do
      {:ok, path}
    else
      _ -> :error
    end
  end

  defp differences_folder(folder), do: Path.join(folder, "differences")
end
