defmodule Situ.Simulation.Timers do
  @moduledoc false
  # The timers of a simulation, ordered by virtual time. Timers in the background never make the time pass; they fire
  # when it has passed for another one.

  @none :gb_sets.empty()

  defstruct wait: @none, background: @none, by_ref: %{}, count: 0

  @type kind :: :wait | :background
  @type timer :: {reference(), pid(), message :: term()}
  @typep entries :: :gb_sets.set({due :: integer(), non_neg_integer(), timer()})
  @type t :: %__MODULE__{
          wait: entries(),
          background: entries(),
          by_ref: %{reference() => {kind(), {integer(), non_neg_integer(), timer()}}},
          count: non_neg_integer()
        }

  @doc "Returns whether time can pass until a timer."
  @spec waiting?(t()) :: boolean()
  def waiting?(%__MODULE__{wait: wait}), do: not :gb_sets.is_empty(wait)

  @doc "Returns whether a timer is due at `time`."
  @spec due_within?(t(), integer()) :: boolean()
  def due_within?(%__MODULE__{} = timers, time),
    do: due?(timers.wait, time) or due?(timers.background, time)

  defp due?(entries, time),
    do: not :gb_sets.is_empty(entries) and elem(:gb_sets.smallest(entries), 0) <= time

  @spec add_timer(t(), kind(), integer(), timer()) :: t()
  def add_timer(%__MODULE__{count: n} = timers, kind, due, {ref, _pid, _message} = timer) do
    entry = {due, n, timer}
    timers = Map.update!(timers, kind, &:gb_sets.add_element(entry, &1))
    %{timers | by_ref: Map.put(timers.by_ref, ref, {kind, entry}), count: n + 1}
  end

  @spec delete_timer(t(), reference()) :: t()
  def delete_timer(%__MODULE__{by_ref: by_ref} = timers, ref) do
    case Map.pop(by_ref, ref) do
      {nil, _} ->
        timers

      {{kind, entry}, by_ref} ->
        Map.update!(%{timers | by_ref: by_ref}, kind, &:gb_sets.del_element(entry, &1))
    end
  end

  @spec delete_process(t(), pid()) :: t()
  def delete_process(%__MODULE__{by_ref: by_ref} = timers, pid) do
    refs = for {ref, {_kind, {_due, _n, {_ref, ^pid, _message}}}} <- by_ref, do: ref
    Enum.reduce(refs, timers, &delete_timer(&2, &1))
  end

  @doc """
  Returns the timers that are due at `now`, or else the next ones, all due at the same time: `[{due, timer}]`.
  """
  @spec list_next(t(), integer()) :: [{integer(), timer()}]
  def list_next(%__MODULE__{wait: wait, background: background} = timers, now) do
    last = if due_within?(timers, now), do: now, else: first_due(wait, background)

    for entries <- [wait, background],
        {due, _n, timer} <- take_until(:gb_sets.iterator(entries), last),
        do: {due, timer}
  end

  # Time passes for a timer in the background only if no other timer is set.
  defp first_due(wait, background) do
    {due, _n, _timer} = :gb_sets.smallest(if :gb_sets.is_empty(wait), do: background, else: wait)

    due
  end

  defp take_until(iterator, last) do
    case :gb_sets.next(iterator) do
      {{due, _n, _timer} = entry, rest} when due <= last -> [entry | take_until(rest, last)]
      _later_or_none -> []
    end
  end
end
