defmodule Situ.Clock.Timers do
  @moduledoc false
  # The timers of a component, ordered by time, and one VM timer (the alarm) for the next time at which it must wake
  # up.
  alias Situ.{Clock, Runtime}

  defstruct tree: :gb_sets.empty(), next: 0, alarm: nil

  @typedoc "`alarm` holds the clock time it is set for, the wait in ms, and the VM's timer."
  @type t :: %__MODULE__{
          tree: :gb_sets.set({Situ.Time.t(), non_neg_integer(), term()}),
          next: non_neg_integer(),
          alarm: {Situ.Time.t(), non_neg_integer(), reference()} | nil
        }

  @doc "Adds a timer. Timers with the same time fire in the order in which they were added."
  @spec add(t(), Situ.Time.t(), term()) :: t()
  def add(%__MODULE__{tree: tree, next: next} = timers, time, key),
    do: %{timers | tree: :gb_sets.add_element({time, next, key}, tree), next: next + 1}

  @doc "Removes all timers but keeps the alarm, because waiting messages may need it."
  @spec clear(t()) :: t()
  def clear(%__MODULE__{} = timers), do: %{timers | tree: :gb_sets.empty()}

  @doc "Returns the keys of the timers with their times, in order."
  @spec to_list(t()) :: [{Situ.Time.t(), term()}]
  def to_list(%__MODULE__{tree: tree}),
    do: for({time, _, key} <- :gb_sets.to_list(tree), do: {time, key})

  @doc "Takes the timers that are due at `now`, in order."
  @spec take_due(t(), Situ.Time.t()) :: {[term()], t()}
  def take_due(%__MODULE__{tree: tree} = timers, now) do
    {keys, tree} = collect_due(tree, now, [])
    {keys, %{timers | tree: tree}}
  end

  defp collect_due(tree, now, keys) do
    with false <- :gb_sets.is_empty(tree),
         {{time, _, key}, rest} when time <= now <- :gb_sets.take_smallest(tree) do
      collect_due(rest, now, [key | keys])
    else
      _ -> {Enum.reverse(keys), tree}
    end
  end

  @doc "Drops the timers that are later than `final`."
  @spec drop_after(t(), Situ.Time.t()) :: t()
  def drop_after(%__MODULE__{tree: tree} = timers, final),
    do: %{timers | tree: :gb_sets.filter(fn {time, _, _} -> time <= final end, tree)}

  @spec next_time(t()) :: Situ.Time.t() | nil
  def next_time(%__MODULE__{tree: tree}),
    do: if(:gb_sets.is_empty(tree), do: nil, else: tree |> :gb_sets.smallest() |> elem(0))

  @doc "Returns whether neither a timer nor the alarm is set."
  @spec idle?(t()) :: boolean()
  def idle?(%__MODULE__{alarm: nil, tree: tree}), do: :gb_sets.is_empty(tree)
  def idle?(%__MODULE__{}), do: false

  @doc "Forgets the alarm after it has fired."
  @spec clear_alarm(t()) :: t()
  def clear_alarm(%__MODULE__{} = timers), do: %{timers | alarm: nil}

  @doc "Sets the alarm to send `{:situ_alarm, due}` at clock time `due`; `nil` cancels it."
  @spec set_alarm(t(), Situ.Time.t() | nil, Clock.t()) :: t()
  def set_alarm(%__MODULE__{alarm: nil} = timers, nil, _clock), do: timers
  def set_alarm(%__MODULE__{} = timers, nil, _clock), do: cancel_alarm(timers)

  def set_alarm(%__MODULE__{} = timers, due, clock),
    do: update_alarm(timers, due, Clock.wait_ms(clock, due))

  defp update_alarm(%{alarm: {due, wait, _}} = timers, due, wait) when wait != :never, do: timers
  defp update_alarm(timers, _due, :never), do: cancel_alarm(timers)

  defp update_alarm(timers, due, wait) do
    timer = Runtime.send_after({:situ_alarm, due}, wait)
    %{cancel_alarm(timers) | alarm: {due, wait, timer}}
  end

  defp cancel_alarm(%{alarm: nil} = timers), do: timers

  defp cancel_alarm(%{alarm: {_, _, timer}} = timers) do
    Runtime.cancel_timer(timer)
    %{timers | alarm: nil}
  end
end
