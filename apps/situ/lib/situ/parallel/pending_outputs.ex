defmodule Situ.Parallel.PendingOutputs do
  @moduledoc false
  # The times whose outputs are undecided, in order, with the live branches at each time, their values, and the number
  # of branches that may still add a value. Outputs are emitted in order of time.

  @enforce_keys [:missing, :creator]
  defstruct [:missing, :creator, waiting: %{}, order: :queue.new()]

  @typedoc "The branches of an output: the first n positions, or keys."
  @type live :: non_neg_integer() | [term()]
  @type t :: %__MODULE__{}

  @doc "Builds an empty state. `creator` builds the output from the list or map of values."
  @spec new(:drop | {:value, term()}, (list() | map() -> term())) :: t()
  def new(missing, creator), do: %__MODULE__{missing: missing, creator: creator}

  @doc "Returns the number of waiting times."
  @spec waiting_count(t()) :: non_neg_integer()
  def waiting_count(pending), do: map_size(pending.waiting)

  @doc "Returns whether the first undecided output waits for the branch that these times wait for."
  @spec awaited?(t(), times()) :: boolean()
  def awaited?(pending, {front, rear}) do
    case {:queue.peek(pending.order), front} do
      {:empty, _} -> false
      {{:value, time}, []} -> rear != [] and List.last(rear) == time
      {{:value, time}, [first | _]} -> time == first
    end
  end

  @doc "Adds a time at which `open` branches are undecided."
  @spec add_time(t(), Situ.Time.t(), live(), map(), non_neg_integer()) :: t()
  def add_time(pending, time, live, values, open) do
    waiting = Map.put(pending.waiting, time, {live, values, open})
    %{pending | waiting: waiting, order: :queue.in(time, pending.order)}
  end

  defp put_value(%{waiting: waiting} = pending, time, key, value) do
    %{^time => {live, values, open}} = waiting
    %{pending | waiting: %{waiting | time => {live, Map.put(values, key, value), open - 1}}}
  end

  defp mark_missing(%{waiting: waiting} = pending, time) do
    %{^time => {live, values, open}} = waiting
    %{pending | waiting: %{waiting | time => {live, values, open - 1}}}
  end

  @typedoc "The times that wait for a branch, in order: the first ones, and the others in reverse."
  @type times :: {[Situ.Time.t()], [Situ.Time.t()]}

  @spec no_times() :: times()
  def no_times, do: {[], []}

  @spec append_time(times(), Situ.Time.t()) :: times()
  def append_time({front, rear}, time), do: {front, [time | rear]}

  @doc """
  Adds outputs of a branch, in order, to the times that wait for it, and returns the remaining times. The branch has no
  more outputs up to `passed_time`; `nil` if that is not known, `:infinity` if it has ended.
  """
  @spec settle_times(
          t(),
          term(),
          times(),
          [{Situ.Time.t(), term()}],
          Situ.Time.t() | nil | :infinity
        ) ::
          {times(), t()}
  def settle_times(pending, key, {front, []}, outputs, passed_time),
    do: settle_outputs(outputs, passed_time, front, key, pending)

  def settle_times(pending, key, {front, rear}, outputs, passed_time),
    do: settle_outputs(outputs, passed_time, front ++ :lists.reverse(rear), key, pending)

  defp settle_outputs([{time, value} | outputs], passed, [time | times], key, pending),
    do: settle_outputs(outputs, passed, times, key, put_value(pending, time, key, value))

  defp settle_outputs([{at, _} | _] = outputs, passed, [time | times], key, pending)
       when time < at,
       do: settle_outputs(outputs, passed, times, key, mark_missing(pending, time))

  defp settle_outputs([_unneeded | outputs], passed, times, key, pending),
    do: settle_outputs(outputs, passed, times, key, pending)

  # An atom is greater than any time.
  defp settle_outputs([], passed, [time | times], key, pending)
       when passed != nil and time <= passed,
       do: settle_outputs([], passed, times, key, mark_missing(pending, time))

  defp settle_outputs([], _passed, times, _key, pending), do: {{times, []}, pending}

  @doc "Takes the decided outputs, up to the first undecided time."
  @spec take_decided(t()) :: {[Situ.Component.action()], t()}
  def take_decided(pending), do: take_decided(pending, [])

  defp take_decided(pending, outputs) do
    with {:value, time} <- :queue.peek(pending.order),
         {live, values, 0} <- Map.fetch!(pending.waiting, time) do
      waiting = Map.delete(pending.waiting, time)
      pending = %{pending | order: :queue.drop(pending.order), waiting: waiting}
      take_decided(pending, build_output(pending, time, live, values) ++ outputs)
    else
      _ -> {:lists.reverse(outputs), pending}
    end
  end

  @doc "Builds the output of a time at which all values are known."
  @spec build_output(t(), Situ.Time.t(), live(), map()) :: [Situ.Component.action()]
  def build_output(pending, time, live, values) do
    case {map_size(values) == live_count(live), pending.missing} do
      {true, _} ->
        [{:out, time, pending.creator.(shape_values(live, values, nil))}]

      {false, {:value, value}} ->
        [{:out, time, pending.creator.(shape_values(live, values, value))}]

      {false, :drop} ->
        []
    end
  end

  defp shape_values(n, values, default) when is_integer(n),
    do: for(key <- live_keys(n), do: Map.get(values, key, default))

  defp shape_values(keys, values, _default) when map_size(values) == length(keys), do: values
  defp shape_values(keys, values, default), do: Map.new(keys, &{&1, Map.get(values, &1, default)})

  @doc "Builds the output of a time at which every branch has a value. `pairs` has the last position first."
  @spec build_complete(t(), Situ.Time.t(), list() | map(), [{term(), term()}]) ::
          [Situ.Component.action()]
  def build_complete(pending, time, parts, pairs) when is_list(parts),
    do: [{:out, time, pending.creator.(collect_values(pairs, []))}]

  def build_complete(pending, time, _parts, pairs),
    do: [{:out, time, pending.creator.(:maps.from_list(pairs))}]

  defp collect_values([], values), do: values
  defp collect_values([{_, value} | pairs], values), do: collect_values(pairs, [value | values])

  @doc "Returns the keys of live branches."
  @spec live_keys(live()) :: [term()]
  def live_keys(n) when is_integer(n), do: Enum.to_list(0..(n - 1)//1)
  def live_keys(keys), do: keys

  defp live_count(n) when is_integer(n), do: n
  defp live_count(keys), do: length(keys)
end
