defmodule Situ.Parallel.Branches do
  @moduledoc false
  # The pure core of parallel: sends the parts of a message to branches, ends branches, and recombines the branches'
  # values for a time. A strategy runs the branches (`Situ.Parallel.Strategy`).
  #
  # A message's time is decided when every live branch has a value at that time, or is known to have none: it has
  # emitted a later output, has passed the time without output, or has ended. Branches that are chains of light
  # operators are decided immediately. Only a branch knows which times wait for it, so nothing refers to a branch that
  # has ended.
  # See docs/adr/0020-parallel-branches-are-values-or-pipelines.md.
  alias Situ.Component.Snapshot
  alias Situ.{Message, Time}
  alias Situ.Parallel.{Parts, PendingOutputs, Strategy, Termination}

  @enforce_keys [:strategy, :running, :form, :termination, :pending]
  defstruct [
    :strategy,
    :running,
    :form,
    :termination,
    :pending,
    on_failure: :stop,
    branches: %{},
    waiting: %{},
    output?: nil,
    started: 0,
    failed: 0
  ]

  @typedoc """
  `running` is the state of the strategy, `branches` has the branch of each key, and `waiting` the undecided times that
  wait for a branch, with its key. Branches that are references keep theirs after they have been closed, until they end.
  """
  @type t :: %__MODULE__{}
  @type outputs :: [Situ.Component.action()]

  @doc """
  Builds the state.

  * `strategy` and `running`: a module with the behaviour `Situ.Parallel.Strategy`, and its state
  * `form`: `{:fixed, n}`, `:variable` (lists), `:sparse` or `:present` (maps: all live keys, or the message's keys)
  * `termination`: a rule of `Situ.Parallel.Termination`, for maps
  * `missing`: `:drop`, or `{:value, default}`
  * `creator`: builds the output from the list or map of values
  * `on_failure`: `:stop` or `:restart`
  """
  @spec new(keyword()) :: t()
  def new(opts) do
    {join, opts} = Keyword.split(opts, [:missing, :creator])
    struct!(__MODULE__, [pending: PendingOutputs.new(join[:missing], join[:creator])] ++ opts)
  end

  @doc "Handles the parts of one message: a list or a map."
  @spec push_message(t(), Message.t(), list() | map()) :: {outputs(), t()}
  def push_message(core, message, parts) do
    time = message.originating_time
    {values, late, core} = parts |> Parts.to_pairs() |> feed_parts(core, message, {[], [], []})
    {ended, termination} = Termination.end_keys(core.termination, core.branches, parts, time)

    {outputs, core} =
      join_values(%{core | termination: termination}, time, parts, {values, late, ended})

    end_branches(core, ended, outputs)
  end

  @doc "Closes the input, which ends every branch."
  @spec close_input(t(), Time.t()) :: {outputs(), t()}
  def close_input(core, time),
    do: end_branches(core, for({key, _branch} <- core.branches, do: {key, time}), [])

  @doc "Handles an event of the strategy."
  @spec handle_event(t(), Strategy.event()) :: {outputs(), t()}
  def handle_event(core, {:outputs, branch, outputs, passed_time}),
    do: core |> settle_times(branch, outputs, passed_time) |> flush_outputs()

  def handle_event(core, {:ended, key, branch, result}) do
    core = if match?(%{^key => ^branch}, core.branches), do: delete_branch(core, key), else: core
    core = if result == :ok, do: core, else: %{core | failed: core.failed + 1}
    core |> settle_times(branch, [], :infinity) |> flush_outputs()
  end

  def handle_event(core, :other), do: {[], core}

  @doc "Returns the branches, or the keys of branches, that the first undecided time is waiting for."
  @spec awaited_branches(t()) :: [Strategy.branch() | Strategy.key()]
  def awaited_branches(%{pending: pending} = core),
    do: for({at, {_key, times}} <- core.waiting, PendingOutputs.awaited?(pending, times), do: at)

  # Feeding. The accumulator has the values at this time, the keys that are known to have none because they have emitted
  # a later output, and the branches that have changed.

  defp feed_parts([], core, _message, {values, late, []}), do: {values, late, core}

  defp feed_parts([], core, _message, {values, late, changed}) do
    branches = :maps.merge(core.branches, :maps.from_list(changed))
    {values, late, %{core | branches: branches}}
  end

  defp feed_parts([{key, data} | rest], core, message, {values, late, changed} = found) do
    {branch, core} = find_branch(core, key, message.originating_time)

    case run_part(core, key, branch, data, message) do
      {:value, value} ->
        feed_parts(rest, core, message, {[{key, value} | values], late, changed})

      {:value, value, branch} ->
        found = {[{key, value} | values], late, [{key, branch} | changed]}
        feed_parts(rest, core, message, found)

      report ->
        {found, core} = add_report(report, key, message.originating_time, found, core)
        feed_parts(rest, core, message, found)
    end
  end

  defp find_branch(core, key, time) do
    case core.branches do
      %{^key => branch} ->
        {branch, core}

      branches ->
        {branch, output?, running} = core.strategy.start_branch(core.running, key, time)
        branches = Map.put(branches, key, branch)
        core = %{core | running: running, branches: branches, started: core.started + 1}
        # The first branch shows whether branches have outputs.
        {branch, if(core.output? == nil, do: %{core | output?: output?}, else: core)}
    end
  end

  defp run_part(%{on_failure: :stop} = core, key, branch, data, message),
    do: core.strategy.push_part(core.running, key, branch, data, message)

  defp run_part(core, key, branch, data, message) do
    core.strategy.push_part(core.running, key, branch, data, message)
  rescue
    _error -> :failed
  end

  defp add_report(:skip, _key, _now, found, core), do: {found, core}

  defp add_report({:skip, branch}, key, _now, {values, late, changed}, core),
    do: {{values, late, [{key, branch} | changed]}, core}

  defp add_report({:sent, running}, _key, _now, found, core),
    do: {found, %{core | running: running}}

  defp add_report({:outputs, outputs, branch}, key, now, {values, late, changed}, core) do
    core = settle_times(core, key, outputs, nil)
    changed = [{key, branch} | changed]

    case Enum.drop_while(outputs, fn {time, _} -> time < now end) do
      [{^now, value} | _] -> {{[{key, value} | values], late, changed}, core}
      [_later | _] -> {{values, [key | late], changed}, core}
      [] -> {{values, late, changed}, core}
    end
  end

  defp add_report(:failed, key, _now, found, core) do
    core = delete_branch(%{core | failed: core.failed + 1}, key)
    {found, settle_times(core, key, [], :infinity)}
  end

  # Joining. The branches that end with this message are still live branches of it, except that their keys are not in
  # the output of all live keys.

  defp join_values(%{output?: false} = core, _time, _parts, _found), do: {[], core}

  defp join_values(core, time, parts, {values, late, ended}) do
    values = if ended == [], do: values, else: remaining_values(core, values, ended)

    if length(values) == live_count(core, parts, ended) and nothing_waits?(core),
      do: {PendingOutputs.build_complete(core.pending, time, parts, values), core},
      else: emit_or_wait(core, time, parts, {Map.new(values), late, ended})
  end

  defp emit_or_wait(core, time, parts, {values, late, ended}) do
    live = live_branches(core, parts, ended)
    open = for key <- PendingOutputs.live_keys(live), open?(core, key, values, late), do: key

    if open == [] and nothing_waits?(core) do
      {PendingOutputs.build_output(core.pending, time, live, values), core}
    else
      pending = PendingOutputs.add_time(core.pending, time, live, values, length(open))

      open
      |> Enum.reduce(%{core | pending: pending}, &wait_for(&2, &1, parts, time))
      |> flush_outputs()
    end
  end

  defp remaining_values(%{form: :sparse}, values, ended) do
    ended = Map.new(ended)
    Enum.reject(values, fn {key, _value} -> is_map_key(ended, key) end)
  end

  defp remaining_values(_core, values, _ended), do: values

  defp live_count(%{form: {:fixed, n}}, _parts, _ended), do: n
  defp live_count(%{form: :variable}, parts, _ended), do: length(parts)
  defp live_count(%{form: :present}, parts, _ended), do: map_size(parts)
  defp live_count(core, _parts, ended), do: map_size(core.branches) - length(ended)

  defp live_branches(%{form: :present}, parts, _ended), do: Map.keys(parts)

  defp live_branches(%{form: :sparse} = core, _parts, ended),
    do: core.branches |> Map.drop(for({key, _time} <- ended, do: key)) |> Map.keys()

  defp live_branches(core, parts, ended), do: live_count(core, parts, ended)

  defp nothing_waits?(core), do: PendingOutputs.waiting_count(core.pending) == 0

  # Returns whether the branch may still emit an output at this time.
  defp open?(_core, key, values, _late) when is_map_key(values, key), do: false

  defp open?(core, key, _values, late) do
    case core.branches do
      %{^key => branch} -> not core.strategy.immediate?(branch) and key not in late
      _failed -> false
    end
  end

  defp wait_for(core, key, parts, time) do
    branch = Map.fetch!(core.branches, key)
    at = if is_reference(branch), do: branch, else: key
    {_key, times} = Map.get(core.waiting, at, {key, PendingOutputs.no_times()})
    waiting = Map.put(core.waiting, at, {key, PendingOutputs.append_time(times, time)})

    if is_list(parts) or is_map_key(parts, key),
      do: %{core | waiting: waiting},
      else: %{
        core
        | waiting: waiting,
          running: core.strategy.pass_time(core.running, branch, time)
      }
  end

  # Ending

  defp end_branches(core, [], outputs), do: {outputs, core}

  defp end_branches(core, ended, outputs) do
    {more, core} = ended |> Enum.reduce(core, &end_branch/2) |> flush_outputs()
    {outputs ++ more, core}
  end

  defp end_branch({key, time}, core) do
    result = close_branch(core, key, Map.fetch!(core.branches, key), time || 0)
    core = delete_branch(core, key)

    case result do
      {:closed, outputs} -> settle_times(core, key, outputs, :infinity)
      {:later, running} -> %{core | running: running}
    end
  end

  defp close_branch(%{on_failure: :stop} = core, key, branch, time),
    do: core.strategy.close_branch(core.running, key, branch, time)

  defp close_branch(core, key, branch, time) do
    core.strategy.close_branch(core.running, key, branch, time)
  rescue
    _error -> {:closed, []}
  end

  defp delete_branch(core, key), do: %{core | branches: Map.delete(core.branches, key)}

  # Adds outputs of a branch to the times that wait for it. It has no more outputs up to `passed_time`.
  defp settle_times(core, at, outputs, passed_time) do
    case core.waiting do
      %{^at => {key, times}} = waiting ->
        {times, pending} =
          PendingOutputs.settle_times(core.pending, key, times, outputs, passed_time)

        waiting =
          if passed_time == :infinity,
            do: Map.delete(waiting, at),
            else: %{waiting | at => {key, times}}

        %{core | pending: pending, waiting: waiting}

      _ ->
        core
    end
  end

  defp flush_outputs(core) do
    {outputs, pending} = PendingOutputs.take_decided(core.pending)
    {outputs, %{core | pending: pending}}
  end

  # Checkpoints

  @doc "Returns the state as plain data."
  @spec take_snapshot(t(), String.t()) :: {:ok, term()} | {:error, Situ.Error.t()}
  def take_snapshot(core, path) do
    with {:ok, branches} <-
           Snapshot.map_states(
             core.branches,
             &core.strategy.snapshot_branch(core.running, &1, &2)
           ),
         do: Snapshot.to_plain_data(%{core | branches: branches, running: nil}, path)
  end

  @doc "Restores the state from the data into `fresh`, a state without branches."
  @spec restore_snapshot(t(), term(), String.t()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def restore_snapshot(fresh, plain, path) do
    {saved, rest} = Map.get_and_update!(plain, :branches, &{&1, %{}})
    time = rest.termination.last_time

    started =
      Enum.reduce(saved, fresh, fn {key, _}, core -> elem(find_branch(core, key, time), 1) end)

    restore = &fresh.strategy.restore_branch(started.running, &1, &2, started.branches[&1])

    with {:ok, branches} <- Snapshot.map_states(saved, restore),
         {:ok, core} <- Snapshot.fill_functions(rest, %{fresh | running: nil}, path),
         do: {:ok, %{core | branches: branches, running: started.running}}
  end
end
