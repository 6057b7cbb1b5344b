defmodule Situ.Parallel.RunningBranches do
  @moduledoc false
  # The running branches of a parallel operator, each in its own pipeline: starts, feeds, stops and removes them.
  # Entries for a branch that has not opened its input yet are kept until it has.
  alias Situ.Branch.Process, as: Branch
  alias Situ.Parallel.ProcessBranches
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.Client

  @type t :: %{ProcessBranches.id() => map()}

  @doc "Starts a branch, with `timing` as in `Situ.Branch.Process.start_pipeline!/5`."
  @spec start_branch(
          t(),
          ProcessBranches.id(),
          (Situ.Stream.t() -> term()),
          {String.t(), Situ.Type.t(), map()}
        ) ::
          t()
  def start_branch(running, id, fun, {path, type, timing}) do
    built = Branch.start_pipeline!(fun, id, path, type, timing)
    monitor = Process.monitor(built.pid)
    shell = %{monitor: monitor, path: path, gate: nil, early: [], stop: nil}
    Map.put(running, id, Map.merge(built, shell))
  end

  @doc "Ends all branches that are not in `before`."
  @spec stop_new_branches(t(), t()) :: :ok
  def stop_new_branches(running, before) do
    for {id, branch} <- running, not is_map_key(before, id) do
      Process.demonitor(branch.monitor, [:flush])
      send(branch.pid, :situ_stop)
    end

    :ok
  end

  @doc "Carries out the pool's orders. All entries for one branch are sent in one message."
  @spec carry_out([ProcessBranches.order()], t()) :: t()
  def carry_out(orders, running) do
    {running, entries} = Enum.reduce(orders, {running, %{}}, &carry_out_one/2)

    Enum.reduce(entries, running, fn {id, entries}, running ->
      feed_branch(running, id, entries)
    end)
  end

  defp carry_out_one({:feed, id, entry}, {running, entries}),
    do: {running, prepend_entry(entries, id, entry)}

  # Only chains of light operators report the times they have passed.
  defp carry_out_one({:pass, id, time}, {running, entries}) do
    if Map.fetch!(running, id).immediate?,
      do: {running, prepend_entry(entries, id, time)},
      else: {running, entries}
  end

  defp carry_out_one({:stop, id, time}, {running, entries}) do
    {mine, entries} = Map.pop(entries, id, [])
    {running |> feed_branch(id, mine) |> stop_branch(id, time), entries}
  end

  defp prepend_entry(entries, id, entry) do
    case entries do
      %{^id => before} -> %{entries | id => [entry | before]}
      _ -> Map.put(entries, id, [entry])
    end
  end

  defp stop_branch(running, id, time) do
    case Map.fetch!(running, id) do
      %{gate: nil} = branch ->
        %{running | id => %{branch | stop: time}}

      branch ->
        Branch.request_stop(branch.pid, time)
        running
    end
  end

  @doc "Records that a branch has opened its input, and sends it the waiting entries."
  @spec put_gate(t(), ProcessBranches.id(), pid()) :: t()
  def put_gate(running, id, gate) do
    branch = Map.fetch!(running, id)
    if branch.early != [], do: Branch.send_entries(gate, Enum.reverse(branch.early))
    if branch.stop, do: Branch.request_stop(branch.pid, branch.stop)
    %{running | id => %{branch | gate: gate, early: []}}
  end

  @doc "Removes a branch that has ended."
  @spec remove_branch(t(), ProcessBranches.id()) :: t()
  def remove_branch(running, id) do
    {branch, running} = Map.pop!(running, id)
    Process.demonitor(branch.monitor, [:flush])
    running
  end

  @doc "Returns the branch and its result if this message reports the end of a branch, otherwise `nil`."
  @spec find_ended(term(), t()) :: {ProcessBranches.id(), Situ.Pipeline.result()} | nil
  def find_ended({id, result}, running) when is_map_key(running, id), do: {id, result}

  def find_ended({:DOWN, _monitor, :process, pid, reason}, running) do
    with {id, branch} <- Enum.find(running, fn {_, branch} -> branch.pid == pid end),
         do: {id, {:error, killed_error(branch.path, reason)}}
  end

  def find_ended(_other, _fleet), do: nil

  @doc "Returns whether any of these branches is working. Chains of light operators count, since they report when done."
  @spec at_work?(t(), [ProcessBranches.id()]) :: boolean()
  def at_work?(running, ids) do
    Enum.any?(ids, fn id ->
      branch = Map.fetch!(running, id)
      branch.immediate? or Client.call(branch.pid, :quiet?) != true
    end)
  end

  @doc "Returns the counters of the running branches, which change while any branch makes progress."
  @spec progress_marks(t()) :: term()
  def progress_marks(running),
    do: for({id, branch} <- running, do: {id, Client.call(branch.pid, :mark)})

  # Entries are newest first.
  defp feed_branch(running, _id, []), do: running

  defp feed_branch(running, id, entries) do
    case Map.fetch!(running, id) do
      %{gate: nil} = branch ->
        %{running | id => %{branch | early: entries ++ branch.early}}

      %{gate: gate} ->
        Branch.send_entries(gate, :lists.reverse(entries))
        running
    end
  end

  defp killed_error(path, reason) do
    what = "#{path} was killed: #{inspect(reason, limit: 8)}"
    %{Errors.pipeline_crashed(reason) | code: :branch_killed, what: what}
  end
end
