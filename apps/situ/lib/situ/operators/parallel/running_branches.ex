defmodule Situ.Parallel.RunningBranches do
  @moduledoc false
  # The running branches of a parallel operator, each a pipeline of its own: started, fed, stopped, removed. Entries
  # for a branch that has not opened its input yet wait until it has.
  alias Situ.Branch.Process, as: Branch
  alias Situ.Parallel.ProcessBranches
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.Client

  @type t :: %{ProcessBranches.id() => map()}

  @doc "Starts a branch; `timing` as of `Situ.Branch.Process.start!/5`."
  @spec begin(
          t(),
          ProcessBranches.id(),
          (Situ.Stream.t() -> term()),
          {String.t(), Situ.Type.t(), map()}
        ) ::
          t()
  def begin(fleet, id, fun, {path, type, timing}) do
    built = Branch.start!(fun, id, path, type, timing)
    monitor = Process.monitor(built.pid)
    shell = %{monitor: monitor, path: path, gate: nil, early: [], stop: nil}
    Map.put(fleet, id, Map.merge(built, shell))
  end

  @doc "Ends branches that are not among those `before`."
  @spec abandon(t(), t()) :: :ok
  def abandon(fleet, before) do
    for {id, branch} <- fleet, not is_map_key(before, id) do
      Process.demonitor(branch.monitor, [:flush])
      send(branch.pid, :situ_stop)
    end

    :ok
  end

  @doc "Carries out the pool's orders; all entries for one branch go in one message."
  @spec carry_out([ProcessBranches.order()], t()) :: t()
  def carry_out(orders, fleet) do
    {fleet, entries} = Enum.reduce(orders, {fleet, %{}}, &carry_out_one/2)
    Enum.reduce(entries, fleet, fn {id, entries}, fleet -> feed(fleet, id, entries) end)
  end

  defp carry_out_one({:feed, id, entry}, {fleet, entries}),
    do: {fleet, later(entries, id, entry)}

  # Only a run of light operators tells what it has passed.
  defp carry_out_one({:pass, id, time}, {fleet, entries}) do
    if Map.fetch!(fleet, id).immediate?,
      do: {fleet, later(entries, id, time)},
      else: {fleet, entries}
  end

  defp carry_out_one({:stop, id, time}, {fleet, entries}) do
    {mine, entries} = Map.pop(entries, id, [])
    {fleet |> feed(id, mine) |> stop(id, time), entries}
  end

  defp later(entries, id, entry) do
    case entries do
      %{^id => before} -> %{entries | id => [entry | before]}
      _ -> Map.put(entries, id, [entry])
    end
  end

  defp stop(fleet, id, time) do
    case Map.fetch!(fleet, id) do
      %{gate: nil} = branch ->
        %{fleet | id => %{branch | stop: time}}

      branch ->
        Branch.stop(branch.pid, time)
        fleet
    end
  end

  @doc "Notes that a branch has opened its input, and sends it the entries that waited."
  @spec opened(t(), ProcessBranches.id(), pid()) :: t()
  def opened(fleet, id, gate) do
    branch = Map.fetch!(fleet, id)
    if branch.early != [], do: Branch.feed(gate, Enum.reverse(branch.early))
    if branch.stop, do: Branch.stop(branch.pid, branch.stop)
    %{fleet | id => %{branch | gate: gate, early: []}}
  end

  @doc "Removes a branch that has ended."
  @spec remove(t(), ProcessBranches.id()) :: t()
  def remove(fleet, id) do
    {branch, fleet} = Map.pop!(fleet, id)
    Process.demonitor(branch.monitor, [:flush])
    fleet
  end

  @doc "The branch and its result, if this message reports the end of a branch; else `nil`."
  @spec ended(term(), t()) :: {ProcessBranches.id(), Situ.Pipeline.result()} | nil
  def ended({id, result}, fleet) when is_map_key(fleet, id), do: {id, result}

  def ended({:DOWN, _monitor, :process, pid, reason}, fleet) do
    with {id, branch} <- Enum.find(fleet, fn {_, branch} -> branch.pid == pid end),
         do: {id, {:error, killed(branch.path, reason)}}
  end

  def ended(_other, _fleet), do: nil

  @doc "Whether one of these branches is still working; a run of light operators reports by itself when it is done."
  @spec at_work?(t(), [ProcessBranches.id()]) :: boolean()
  def at_work?(fleet, ids) do
    Enum.any?(ids, fn id ->
      branch = Map.fetch!(fleet, id)
      branch.immediate? or Client.call(branch.pid, :quiet?) != true
    end)
  end

  @doc "The counters of the running branches; they change while any branch makes progress."
  @spec marks(t()) :: term()
  def marks(fleet), do: for({id, branch} <- fleet, do: {id, Client.call(branch.pid, :mark)})

  # Entries come newest first.
  defp feed(fleet, _id, []), do: fleet

  defp feed(fleet, id, entries) do
    case Map.fetch!(fleet, id) do
      %{gate: nil} = branch ->
        %{fleet | id => %{branch | early: entries ++ branch.early}}

      %{gate: gate} ->
        Branch.feed(gate, :lists.reverse(entries))
        fleet
    end
  end

  defp killed(path, reason) do
    what = "#{path} was killed: #{inspect(reason, limit: 8)}"
    %{Errors.crashed(reason) | code: :branch_killed, what: what}
  end
end
