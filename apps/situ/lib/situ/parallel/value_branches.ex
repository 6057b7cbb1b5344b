defmodule Situ.Parallel.ValueBranches do
  @moduledoc false
  # The pure core of parallel: sends the parts of a message to branches, and recombines the branches' values for a time.
  #
  # A message's time is decided when every live branch has a value at that time, or is known to have none. Branches that
  # are chains of light operators are decided immediately. Other branches are decided when they emit a later output or
  # end. Waiting times are entries, which are emitted in order. Only a branch knows which times are waiting for it, so
  # nothing refers to a branch that has ended.
  # See docs/adr/0020-parallel-branches-are-values-or-pipelines.md.

  alias Situ.Branch
  alias Situ.Branch.Chain
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
  @spec push_message(t(), Situ.Message.t(), list() | map()) :: {[Situ.Component.action()], t()}
  def push_message(core, message, parts) do
    time = message.originating_time

    {branches, values, core} =
      parts |> Parts.to_pairs() |> feed_parts(core.branches, [], message, core)

    core = %{core | branches: branches}

    core =
      if core.form in [:sparse, :present], do: terminate_branches(core, parts, time), else: core

    if core.output == false,
      do: {[], core},
      else: emit_or_wait(core, time, parts, values)
  end

  @doc "Closes the input, which ends every branch."
  @spec close_input(t(), Situ.Time.t()) :: {[Situ.Component.action()], t()}
  def close_input(core, time) do
    core =
      Enum.reduce(core.branches, core, fn {key, branch}, core ->
        finish_branch(core, key, branch, time)
      end)

    flush_outputs(%{core | branches: %{}})
  end

  # Feeding. A branch is `{branch, last_seen, absences, waiting}`, where `waiting` is the undecided times, oldest first.

  defp feed_parts([], branches, values, _message, core), do: {branches, values, core}

  defp feed_parts([{key, data} | rest], branches, values, message, core) do
    {entry, branches, core} = ensure_branch(key, branches, core)
    {branch, _seen, _absent, waiting} = entry

    case run_branch(branch, data, message, core) do
      {:value, value, same} when same == branch and waiting == [] ->
        branches = note_seen(branches, key, entry, message.originating_time, core)
        feed_parts(rest, branches, [{key, value} | values], message, core)

      {:value, value, branch} ->
        branches = Map.put(branches, key, {branch, message.originating_time, 0, waiting})
        feed_parts(rest, branches, [{key, value} | values], message, core)

      {:skip, branch} ->
        branches = Map.put(branches, key, {branch, message.originating_time, 0, waiting})
        feed_parts(rest, branches, values, message, core)

      {:outputs, outputs, branch} ->
        {values, waiting, core} =
          sort_outputs(outputs, key, message.originating_time, values, waiting, core)

        branches = Map.put(branches, key, {branch, message.originating_time, 0, waiting})
        feed_parts(rest, branches, values, message, core)

      :failed ->
        core = mark_missing(%{core | failed: core.failed + 1}, waiting)
        feed_parts(rest, Map.delete(branches, key), values, message, core)
    end
  end

  # Branches of lists do not need the time at which they were last seen.
  defp note_seen(branches, _key, _entry, _time, %{form: form})
       when form not in [:sparse, :present],
       do: branches

  defp note_seen(branches, key, {branch, _, _, waiting}, time, _core),
    do: Map.put(branches, key, {branch, time, 0, waiting})

  defp ensure_branch(key, branches, core) do
    case branches do
      %{^key => entry} ->
        {entry, branches, core}

      _ ->
        branch = core.start.(key)
        output = if core.output == nil, do: Branch.has_output?(branch), else: core.output
        entry = {branch, nil, 0, []}

        {entry, Map.put(branches, key, entry),
         %{core | started: core.started + 1, output: output}}
    end
  end

  defp run_branch(branch, data, message, %{on_failure: :stop}),
    do: step_branch(branch, data, message)

  defp run_branch(branch, data, message, _core) do
    step_branch(branch, data, message)
  rescue
    _error -> :failed
  end

  defp step_branch(%Chain{} = branch, data, message),
    do: Chain.push_data(branch, data, message)

  defp step_branch(branch, data, message) do
    {outputs, branch} = Branch.push(branch, %{message | data: data})
    {:outputs, outputs, branch}
  end

  # Sorts a branch's outputs: at the current time, at times that wait for it, or at times that are not needed.
  defp sort_outputs([], _key, _now, values, waiting, core), do: {values, waiting, core}

  defp sort_outputs([{time, value} | rest], key, now, values, waiting, core) do
    {missed, waiting} = Enum.split_while(waiting, &(&1 < time))
    core = mark_missing(core, missed)

    case waiting do
      [^time | waiting] ->
        sort_outputs(rest, key, now, values, waiting, put_value(core, key, time, value))

      _ when time == now ->
        sort_outputs(rest, key, now, [{key, value} | values], waiting, core)

      _ when time > now ->
        sort_outputs(rest, key, now, [{:later, key} | values], waiting, core)

      _ ->
        sort_outputs(rest, key, now, values, waiting, core)
    end
  end

  # Ending branches

  defp terminate_branches(%{termination: :never} = core, _parts, _time), do: core

  defp terminate_branches(%{termination: rule} = core, parts, time) do
    Enum.reduce(Termination.keys_to_check(rule, core.branches, parts), core, fn key, core ->
      entry = {branch, seen, absent, waiting} = Map.fetch!(core.branches, key)

      case Termination.decide_branch(rule, key, {seen, absent}, parts, time) do
        :keep -> core
        {:absent, n} -> put_in(core.branches[key], {branch, time, n, waiting})
        {:close, closing} -> end_branch(core, key, entry, closing)
      end
    end)
  end

  defp end_branch(core, key, entry, time) do
    core = finish_branch(core, key, entry, time)
    %{core | branches: Map.delete(core.branches, key)}
  end

  defp finish_branch(core, key, {branch, _seen, _absent, waiting}, time) do
    {_values, waiting, core} =
      sort_outputs(close_branch(branch, time || 0, core), key, nil, [], waiting, core)

    mark_missing(core, waiting)
  end

  defp close_branch(branch, time, %{on_failure: :stop}), do: Branch.close(branch, time)

  defp close_branch(branch, time, _core) do
    Branch.close(branch, time)
  rescue
    _error -> []
  end

  # Emitting

  defp emit_or_wait(core, time, parts, values) do
    {later, values} = Enum.split_with(values, &match?({:later, _}, &1))
    values = Map.new(values)
    live = live_branches(core, parts, values)
    open = undecided_keys(core, live, values, later)

    if open == [] and PendingOutputs.waiting_count(core.entries) == 0 do
      {PendingOutputs.build_output(core.entries, time, live, values), core}
    else
      core = Enum.reduce(open, core, &add_waiting_time(&2, &1, time))

      flush_outputs(%{
        core
        | entries: PendingOutputs.add_time(core.entries, time, live, values, length(open))
      })
    end
  end

  defp live_branches(%{form: {:fixed, n}}, _parts, _values), do: n
  defp live_branches(%{form: :variable}, parts, _values), do: length(parts)
  defp live_branches(%{form: :present}, parts, _values), do: Map.keys(parts)
  defp live_branches(%{form: :sparse} = core, _parts, _values), do: Map.keys(core.branches)

  # Returns the branches that may still emit an output at this time.
  defp undecided_keys(core, live, values, later) do
    all_there? = map_size(values) == PendingOutputs.live_count(live)

    if all_there?,
      do: [],
      else:
        for(
          key <- PendingOutputs.live_keys(live),
          may_give_value?(core, key, values, later),
          do: key
        )
  end

  defp may_give_value?(_core, key, values, _later) when is_map_key(values, key), do: false

  defp may_give_value?(core, key, _values, later) do
    case core.branches do
      %{^key => {branch, _, _, _}} ->
        not Branch.immediate_output?(branch) and {:later, key} not in later

      _gone ->
        false
    end
  end

  defp add_waiting_time(core, key, time) do
    update_in(core.branches[key], fn {branch, seen, absent, waiting} ->
      {branch, seen, absent, waiting ++ [time]}
    end)
  end

  defp put_value(core, key, time, value),
    do: %{core | entries: PendingOutputs.put_value(core.entries, time, key, value)}

  defp mark_missing(core, times),
    do: %{core | entries: PendingOutputs.mark_missing(core.entries, times)}

  defp flush_outputs(core) do
    {outputs, entries} = PendingOutputs.take_decided(core.entries)
    {outputs, %{core | entries: entries}}
  end
end
