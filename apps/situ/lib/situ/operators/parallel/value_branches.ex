defmodule Situ.Parallel.ValueBranches do
  @moduledoc false
  # The pure core of parallel: sends the parts of a message to branches, and recombines the branches' values for a time.
  #
  # A message's time is decided when every live branch has a value at that time, or is known to have none. Branches that
  # are chains of light operators are decided immediately. Other branches are decided when they emit a later output or
  # end. Waiting times are entries, which are emitted in order. Only a branch knows which times are waiting for it, so
  # nothing refers to a branch that has ended.

  alias Situ.Branch
  alias Situ.Branch.Chained
  alias Situ.Parallel.{PendingOutputs, Parts, Termination}

  @enforce_keys [:start, :termination, :form, :entries]
  defstruct [
    :start,
    :termination,
    :form,
    :entries,
    on_failure: :stop,
    branches: %{},
    output: nil,
    started: 0,
    failed: 0
  ]

  @type key :: term()
  @type t :: %__MODULE__{}

  @doc """
  Builds the state.

  * `start`: `fun.(key)` starts a branch
  * `form`: `{:fixed, n}`, `:variable` (lists), `:sparse` or `:present` (maps: all live keys, or the message's keys)
  * `termination`: a rule of `Situ.Parallel.Termination`, for maps
  * `missing`: `:drop`, or `{:value, default}`
  * `creator`: builds the output from the list or map of values
  * `on_failure`: `:stop` or `:restart`
  """
  @spec new(keyword()) :: t()
  def new(opts) do
    {entries, opts} = Keyword.split(opts, [:missing, :creator])

    struct!(
      __MODULE__,
      [entries: PendingOutputs.new(entries[:missing], entries[:creator])] ++ opts
    )
  end

  @doc "Handles the parts of one message: a list or a map."
  @spec push(t(), Situ.Message.t(), list() | map()) :: {[Situ.Component.action()], t()}
  def push(core, message, parts) do
    time = message.originating_time
    {branches, values, core} = parts |> Parts.pairs() |> feed(core.branches, [], message, core)
    core = %{core | branches: branches}
    core = if core.form in [:sparse, :present], do: terminate(core, parts, time), else: core

    if core.output == false,
      do: {[], core},
      else: answer(core, time, parts, values)
  end

  @doc "Closes the input, which ends every branch."
  @spec close(t(), Situ.Time.t()) :: {[Situ.Component.action()], t()}
  def close(core, time) do
    core =
      Enum.reduce(core.branches, core, fn {key, branch}, core ->
        finish(core, key, branch, time)
      end)

    flush(%{core | branches: %{}})
  end

  # Feeding. A branch is `{branch, last_seen, absences, waiting}`, where `waiting` is the undecided times, oldest first.

  defp feed([], branches, values, _message, core), do: {branches, values, core}

  defp feed([{key, data} | rest], branches, values, message, core) do
    {entry, branches, core} = existing(key, branches, core)
    {branch, _seen, _absent, waiting} = entry

    case run(branch, data, message, core) do
      {:value, value, same} when same == branch and waiting == [] ->
        branches = seen(branches, key, entry, message.originating_time, core)
        feed(rest, branches, [{key, value} | values], message, core)

      {:value, value, branch} ->
        branches = Map.put(branches, key, {branch, message.originating_time, 0, waiting})
        feed(rest, branches, [{key, value} | values], message, core)

      {:skip, branch} ->
        branches = Map.put(branches, key, {branch, message.originating_time, 0, waiting})
        feed(rest, branches, values, message, core)

      {:outputs, outputs, branch} ->
        {values, waiting, core} =
          sort(outputs, key, message.originating_time, values, waiting, core)

        branches = Map.put(branches, key, {branch, message.originating_time, 0, waiting})
        feed(rest, branches, values, message, core)

      :failed ->
        core = lost(%{core | failed: core.failed + 1}, waiting)
        feed(rest, Map.delete(branches, key), values, message, core)
    end
  end

  # Branches of lists do not need the time at which they were last seen.
  defp seen(branches, _key, _entry, _time, %{form: form}) when form not in [:sparse, :present],
    do: branches

  defp seen(branches, key, {branch, _, _, waiting}, time, _core),
    do: Map.put(branches, key, {branch, time, 0, waiting})

  defp existing(key, branches, core) do
    case branches do
      %{^key => entry} ->
        {entry, branches, core}

      _ ->
        branch = core.start.(key)
        output = if core.output == nil, do: Branch.output?(branch), else: core.output
        entry = {branch, nil, 0, []}

        {entry, Map.put(branches, key, entry),
         %{core | started: core.started + 1, output: output}}
    end
  end

  defp run(branch, data, message, %{on_failure: :stop}), do: step(branch, data, message)

  defp run(branch, data, message, _core) do
    step(branch, data, message)
  rescue
    _error -> :failed
  end

  defp step(%Chained{} = branch, data, message), do: Chained.value(branch, data, message)

  defp step(branch, data, message) do
    {outputs, branch} = Branch.push(branch, %{message | data: data})
    {:outputs, outputs, branch}
  end

  # Sorts a branch's outputs: at the current time, at times that wait for it, or at times that are not needed.
  defp sort([], _key, _now, values, waiting, core), do: {values, waiting, core}

  defp sort([{time, value} | rest], key, now, values, waiting, core) do
    {missed, waiting} = Enum.split_while(waiting, &(&1 < time))
    core = lost(core, missed)

    case waiting do
      [^time | waiting] -> sort(rest, key, now, values, waiting, found(core, key, time, value))
      _ when time == now -> sort(rest, key, now, [{key, value} | values], waiting, core)
      _ when time > now -> sort(rest, key, now, [{:later, key} | values], waiting, core)
      _ -> sort(rest, key, now, values, waiting, core)
    end
  end

  # Ending branches

  defp terminate(%{termination: :never} = core, _parts, _time), do: core

  defp terminate(%{termination: rule} = core, parts, time) do
    Enum.reduce(Termination.asked(rule, core.branches, parts), core, fn key, core ->
      entry = {branch, seen, absent, waiting} = Map.fetch!(core.branches, key)

      case Termination.decide(rule, key, {seen, absent}, parts, time) do
        :keep -> core
        {:absent, n} -> put_in(core.branches[key], {branch, time, n, waiting})
        {:close, closing} -> ended(core, key, entry, closing)
      end
    end)
  end

  defp ended(core, key, entry, time) do
    core = finish(core, key, entry, time)
    %{core | branches: Map.delete(core.branches, key)}
  end

  defp finish(core, key, {branch, _seen, _absent, waiting}, time) do
    {_values, waiting, core} = sort(closed(branch, time || 0, core), key, nil, [], waiting, core)
    lost(core, waiting)
  end

  defp closed(branch, time, %{on_failure: :stop}), do: Branch.close(branch, time)

  defp closed(branch, time, _core) do
    Branch.close(branch, time)
  rescue
    _error -> []
  end

  # Emitting

  defp answer(core, time, parts, values) do
    {later, values} = Enum.split_with(values, &match?({:later, _}, &1))
    values = Map.new(values)
    live = live(core, parts, values)
    open = undecided(core, live, values, later)

    if open == [] and PendingOutputs.size(core.entries) == 0 do
      {PendingOutputs.output(core.entries, time, live, values), core}
    else
      core = Enum.reduce(open, core, &wait(&2, &1, time))
      flush(%{core | entries: PendingOutputs.add(core.entries, time, live, values, length(open))})
    end
  end

  defp live(%{form: {:fixed, n}}, _parts, _values), do: n
  defp live(%{form: :variable}, parts, _values), do: length(parts)
  defp live(%{form: :present}, parts, _values), do: Map.keys(parts)
  defp live(%{form: :sparse} = core, _parts, _values), do: Map.keys(core.branches)

  # Returns the branches that may still emit an output at this time.
  defp undecided(core, live, values, later) do
    all_there? = map_size(values) == PendingOutputs.count(live)

    if all_there?,
      do: [],
      else: for(key <- PendingOutputs.keys(live), waits?(core, key, values, later), do: key)
  end

  defp waits?(_core, key, values, _later) when is_map_key(values, key), do: false

  defp waits?(core, key, _values, later) do
    case core.branches do
      %{^key => {branch, _, _, _}} -> not Branch.immediate?(branch) and {:later, key} not in later
      _gone -> false
    end
  end

  defp wait(core, key, time) do
    update_in(core.branches[key], fn {branch, seen, absent, waiting} ->
      {branch, seen, absent, waiting ++ [time]}
    end)
  end

  defp found(core, key, time, value),
    do: %{core | entries: PendingOutputs.found(core.entries, time, key, value)}

  defp lost(core, times), do: %{core | entries: PendingOutputs.lost(core.entries, times)}

  defp flush(core) do
    {outputs, entries} = PendingOutputs.flush(core.entries)
    {outputs, %{core | entries: entries}}
  end
end
