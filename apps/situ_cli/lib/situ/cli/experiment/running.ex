defmodule Situ.CLI.Experiment.Running do
  @moduledoc false
  # `situ experiment run`: runs an experiment with a status line, and ends it properly at Ctrl-C.
  alias Situ.CLI.Experiment.{Loading, Viewing}
  alias Situ.CLI.{ClusterConnection, Interrupt, Output, Studio, Terminal}
  alias Situ.Experiment.{RunRecord, Runner}
  alias Situ.{Dataset, Error, Time}

  # The status of a process that Ctrl-C ended.
  @interrupted 130

  @methods %{"grid" => :grid, "random" => :random, "halving" => :halving}

  @doc "Runs the verb."
  @spec run_experiment(map(), keyword()) :: 0..255
  def run_experiment(%{file: file, dataset: path}, opts) do
    experiment = Loading.load_experiment!(file)
    dataset = Loading.open_dataset!(path)
    studio = if opts[:studio], do: Studio.show_experiments(path, opts)

    settings = [
      jobs: max(opts[:jobs], 1),
      method: @methods[opts[:method]],
      trials: max(opts[:trials], 1),
      seed: opts[:seed],
      sessions: Loading.session_filter(dataset, opts)
    ]

    case run_interruptibly(experiment, dataset, settings, opts) do
      {:ok, {folder, run}} ->
        Viewing.print_run(folder, run, opts)
        end_run(studio, path, opts)
        if run["failed"] > 0, do: 1, else: 0

      :interrupted ->
        @interrupted

      {:error, error} ->
        raise error
    end
  end

  defp end_run(nil, path, opts) do
    unless opts[:json] || opts[:markdown],
      do: Output.puts("Look at the sets, and at where they differ: situ studio #{path}")
  end

  defp end_run(studio, _path, _opts) do
    Output.warn("The studio shows the experiment until Ctrl-C.")
    Studio.wait_for_exit(studio)
  end

  @doc "Runs an experiment until it ends or is interrupted; `settings` are options of the runner."
  @spec run_interruptibly(Loading.experiment(), Dataset.t(), keyword(), keyword()) ::
          {:ok, {Path.t(), map()}} | :interrupted | {:error, Error.t()}
  def run_interruptibly(experiment, dataset, settings, opts) do
    terminal = Terminal.open(opts)
    me = self()

    # Only the process that has opened the terminal may write to it.
    settings =
      [
        file: experiment.file,
        binaries: experiment.binaries,
        progress: &send(me, {:progress, &1})
      ] ++ settings ++ cluster_settings(opts, &send(me, {:notice, &1}))

    Interrupt.with_message(:interrupted, fn ->
      # A run that crashes must not end the command before it prints the error.
      before = Process.flag(:trap_exit, true)
      task = Task.async(fn -> Runner.run(experiment.module, dataset, settings) end)
      result = await_run(task, dataset, terminal)
      Process.flag(:trap_exit, before)
      Terminal.close(terminal)
      result
    end)
  end

  defp cluster_settings(opts, notify) do
    cond do
      opts[:cluster] ->
        {:ok, _} = Application.ensure_all_started(:situ_cluster)

        # The first call reports a wrong name or folder. Later, a lost node is not an error of the command.
        _ = ClusterConnection.connect_members(opts, opts[:label])
        [nodes: fn -> list_members(opts) end, notify: notify]

      opts[:node] || opts[:label] not in [nil, []] ->
        throw({:usage, "--node and --label need --cluster"})

      true ->
        []
    end
  end

  defp list_members(opts) do
    ClusterConnection.connect_members(opts, opts[:label])
  rescue
    Error -> []
  end

  defp await_run(%{ref: ref} = task, dataset, terminal) do
    receive do
      {:progress, progress} ->
        Terminal.replace_line(terminal, format_progress(progress))
        await_run(task, dataset, terminal)

      {:notice, text} ->
        Terminal.replace_line(terminal, "")
        Output.warn(text)
        await_run(task, dataset, terminal)

      {^ref, result} ->
        Process.demonitor(ref, [:flush])
        with {:error, _} <- result, do: RunRecord.mark_interrupted(dataset)
        result

      {:DOWN, ^ref, _, _, reason} ->
        RunRecord.mark_interrupted(dataset)
        {:error, Error.new(:run_crashed, "the run crashed", why: inspect(reason, limit: 10))}

      :interrupted ->
        Task.shutdown(task, :brutal_kill)
        RunRecord.mark_interrupted(dataset)
        Output.warn("Interrupted. The results so far are kept; the same command continues.")
        :interrupted
    end
  end

  defp format_progress(progress) do
    %{done: done, total: total, failed: failed} = progress
    left = progress.left_s && Time.format_duration(round(progress.left_s) * 1_000_000_000)
    failures = if failed > 0, do: ", #{failed} failed", else: ""
    estimate = if left && done < total, do: ", about #{left} left", else: ""
    "#{done} of #{total} results#{failures}#{estimate}#{format_last(progress.last)}"
  end

  defp format_last(nil), do: ""

  defp format_last(%{"session" => session} = result) do
    node = if name = result["node"], do: " on #{name}", else: ""
    " (#{Output.format_name(session)}#{node})"
  end
end
