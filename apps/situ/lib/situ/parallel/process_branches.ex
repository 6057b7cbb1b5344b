defmodule Situ.Parallel.ProcessBranches do
  @moduledoc false
  # The pure core of parallel with branches in processes: the branch of each key, the times that wait for it, and the
  # messages to send. As in ValueBranches, a time is decided when each of its branches has emitted an output for it, or
  # no longer can: it has emitted a later output, has passed the time without output, or has ended.
  # See docs/adr/0020-parallel-branches-are-values-or-pipelines.md.
  alias Situ.Message
  alias Situ.Parallel.{PendingOutputs, Parts, Termination}

  @enforce_keys [:form, :termination, :entries]
  defstruct [
    :form,
    :termination,
    :entries,
    keys: %{},
    branches: %{},
    output: nil,
    started: 0,
    failed: 0
  ]

  @type id :: reference()
  @type order ::
          {:feed, id(), {Situ.Time.t(), term()}}
          | {:pass, id(), Situ.Time.t()}
          | {:stop, id(), Situ.Time.t()}
  @type outputs :: [Situ.Component.action()]
  @type t :: %__MODULE__{}

  @doc "Builds the state from the options of `Situ.Parallel.ValueBranches.new/1`, except `start` and `on_failure`."
  @spec new(keyword()) :: t()
  def new(opts) do
    {entries, opts} = Keyword.split(opts, [:missing, :creator])

    struct!(
      __MODULE__,
      [entries: PendingOutputs.new(entries[:missing], entries[:creator])] ++ opts
    )
  end

  @doc "Returns the keys of these parts that have no branch."
  @spec keys_without_branch(t(), list() | map()) :: [term()]
  def keys_without_branch(pool, parts) do
    for {key, _} <- Parts.to_pairs(parts), not is_map_key(pool.keys, key), do: key
  end

  @doc "Adds the started branch of `key`. The first branch shows whether branches have outputs."
  @spec put_branch(t(), term(), id(), boolean()) :: t()
  def put_branch(pool, key, id, output?) do
    %{
      pool
      | keys: Map.put(pool.keys, key, {id, nil, 0}),
        branches: Map.put(pool.branches, id, {key, {[], []}}),
        output: if(pool.output == nil, do: output?, else: pool.output),
        started: pool.started + 1
    }
  end

  @doc "Handles the parts of one message. Every key must have a branch."
  @spec push_message(t(), Message.t(), list() | map()) :: {[order()], outputs(), t()}
  def push_message(pool, message, parts) do
    time = message.originating_time
    before = pool.keys
    {feeds, pool} = Enum.map_reduce(Parts.to_pairs(parts), pool, &feed_branch(&1, &2, message))
    {stops, pool} = stop_branches(pool, parts, time)

    if pool.output == false do
      {feeds ++ stops, [], pool}
    else
      live = live_branches(pool, parts)
      keys = PendingOutputs.live_keys(live)

      passes =
        for key <- keys, not has_part?(parts, key), do: {:pass, branch_id(before, key), time}

      pool = Enum.reduce(keys, pool, &add_waiting_time(&2, branch_id(before, &1), time))
      entries = PendingOutputs.add_time(pool.entries, time, live, %{}, length(keys))
      {outputs, pool} = flush_outputs(%{pool | entries: entries})
      {feeds ++ passes ++ stops, outputs, pool}
    end
  end

  @doc """
  Adds outputs of a branch, in order. If `passed_time` is a time, the branch has handled all parts up to it and has no
  more outputs for them.
  """
  @spec add_outputs(t(), id(), [{Situ.Time.t(), term()}], Situ.Time.t() | nil) :: {outputs(), t()}
  def add_outputs(pool, id, reported, passed_time) do
    case pool.branches do
      %{^id => {key, {front, rear}}} ->
        {entries, waiting} =
          settle_times(reported, passed_time, merge_waiting(front, rear), key, pool.entries)

        branches = Map.put(pool.branches, id, {key, {waiting, []}})
        flush_outputs(%{pool | branches: branches, entries: entries})

      _ ->
        {[], pool}
    end
  end

  # Compares the times that wait for the branch with the times of its outputs; both are in order.
  defp settle_times([{at, value} | reported], passed_time, [time | waiting], key, entries)
       when at == time,
       do:
         settle_times(
           reported,
           passed_time,
           waiting,
           key,
           PendingOutputs.put_value(entries, time, key, value)
         )

  defp settle_times([{at, _} | _] = reported, passed_time, [time | waiting], key, entries)
       when time < at,
       do:
         settle_times(
           reported,
           passed_time,
           waiting,
           key,
           PendingOutputs.mark_missing(entries, [time])
         )

  defp settle_times([_not_asked_for | reported], passed_time, waiting, key, entries),
    do: settle_times(reported, passed_time, waiting, key, entries)

  defp settle_times([], passed_time, [time | waiting], key, entries)
       when passed_time != nil and time <= passed_time,
       do:
         settle_times([], passed_time, waiting, key, PendingOutputs.mark_missing(entries, [time]))

  defp settle_times([], _passed, waiting, _key, entries), do: {entries, waiting}

  defp merge_waiting(front, []), do: front
  defp merge_waiting(front, rear), do: front ++ :lists.reverse(rear)

  @doc "Removes a branch that has ended. All its outputs must have been added."
  @spec remove_branch(t(), id()) :: {outputs(), t()}
  def remove_branch(pool, id) do
    case Map.pop(pool.branches, id) do
      {nil, _} ->
        {[], pool}

      {{key, waiting}, branches} ->
        keys = if branch_id(pool.keys, key) == id, do: Map.delete(pool.keys, key), else: pool.keys
        {front, rear} = waiting
        entries = PendingOutputs.mark_missing(pool.entries, merge_waiting(front, rear))
        flush_outputs(%{pool | branches: branches, keys: keys, entries: entries})
    end
  end

  @doc "Closes the input, which ends every branch."
  @spec close_input(t(), Situ.Time.t()) :: {[order()], t()}
  def close_input(pool, time) do
    stops = for {_key, {id, seen, _}} <- pool.keys, do: {:stop, id, stop_time(time, seen)}
    {stops, %{pool | keys: %{}}}
  end

  @doc "Returns the branches that the first undecided time is waiting for."
  @spec awaited_branches(t()) :: [id()]
  def awaited_branches(pool) do
    case PendingOutputs.first_time(pool.entries) do
      {:value, time} ->
        for {id, {_key, {front, rear}}} <- pool.branches,
            match?([^time | _], merge_waiting(front, rear)),
            do: id

      :empty ->
        []
    end
  end

  # Branches of lists do not need the time at which they were last seen.
  defp feed_branch({key, data}, %{form: form} = pool, message)
       when form not in [:sparse, :present] do
    {id, _seen, _absent} = Map.fetch!(pool.keys, key)
    {{:feed, id, {message.originating_time, data}}, pool}
  end

  defp feed_branch({key, data}, pool, message) do
    {id, _seen, _absent} = Map.fetch!(pool.keys, key)
    keys = Map.put(pool.keys, key, {id, message.originating_time, 0})
    {{:feed, id, {message.originating_time, data}}, %{pool | keys: keys}}
  end

  defp stop_branches(%{form: form} = pool, _parts, _time) when form not in [:sparse, :present],
    do: {[], pool}

  defp stop_branches(%{termination: rule} = pool, parts, time) do
    rule
    |> Termination.keys_to_check(pool.keys, parts)
    |> Enum.reduce({[], pool}, fn key, {stops, pool} ->
      {id, seen, absent} = Map.fetch!(pool.keys, key)

      case Termination.decide_branch(rule, key, {seen, absent}, parts, time) do
        :keep -> {stops, pool}
        {:absent, n} -> {stops, %{pool | keys: Map.put(pool.keys, key, {id, time, n})}}
        {:close, at} -> {[{:stop, id, stop_time(at, seen)} | stops], delete_key(pool, key)}
      end
    end)
  end

  # A branch ends after the last message sent to it, even if its rule names an earlier time.
  defp stop_time(at, nil), do: at
  defp stop_time(at, seen), do: max(at, seen)

  defp delete_key(pool, key), do: %{pool | keys: Map.delete(pool.keys, key)}

  defp live_branches(%{form: {:fixed, n}}, _parts), do: n
  defp live_branches(%{form: :variable}, parts), do: length(parts)
  defp live_branches(%{form: :present}, parts), do: Map.keys(parts)
  defp live_branches(%{form: :sparse} = pool, _parts), do: Map.keys(pool.keys)

  # Lists have a part for each live position.
  defp has_part?(parts, _position) when is_list(parts), do: true
  defp has_part?(parts, key), do: is_map_key(parts, key)

  defp branch_id(keys, key) do
    case keys do
      %{^key => {id, _, _}} -> id
      _ -> nil
    end
  end

  defp add_waiting_time(pool, id, time) do
    {key, {front, rear}} = Map.fetch!(pool.branches, id)
    %{pool | branches: Map.put(pool.branches, id, {key, {front, [time | rear]}})}
  end

  defp flush_outputs(pool) do
    {outputs, entries} = PendingOutputs.take_decided(pool.entries)
    {outputs, %{pool | entries: entries}}
  end
end
