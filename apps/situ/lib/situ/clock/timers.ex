defmodule Situ.Clock.Timers do
  @moduledoc false
  # The timers of a component, ordered by time, and one alarm of the VM for all that waits for the clock.
  alias Situ.Clock

  defstruct tree: :gb_sets.empty(), next: 0, alarm: nil

  @typedoc "`alarm`: what is due at which time, the wait in ms, the VM's timer."
  @type t :: %__MODULE__{
          tree: :gb_sets.set({Situ.Time.t(), non_neg_integer(), term()}),
          next: non_neg_integer(),
          alarm: {Situ.Time.t(), non_neg_integer(), reference()} | nil
        }

  @doc "Timers of one time go in the order in which they were set."
  @spec add(t(), Situ.Time.t(), term()) :: t()
  def add(%__MODULE__{tree: tree, next: next} = timers, time, key),
    do: %{timers | tree: :gb_sets.add_element({time, next, key}, tree), next: next + 1}

  @doc "No timers any more; the alarm stays, for messages that wait."
  @spec clear(t()) :: t()
  def clear(%__MODULE__{} = timers), do: %{timers | tree: :gb_sets.empty()}

  @doc "The timers with their times, in order."
  @spec to_list(t()) :: [{Situ.Time.t(), term()}]
  def to_list(%__MODULE__{tree: tree}),
    do: for({time, _, key} <- :gb_sets.to_list(tree), do: {time, key})

  @doc "Takes those that are due at `now`, in order."
  @spec due(t(), Situ.Time.t()) :: {[term()], t()}
  def due(%__MODULE__{tree: tree} = timers, now) do
    {keys, tree} = due(tree, now, [])
    {keys, %{timers | tree: tree}}
  end

  defp due(tree, now, keys) do
    with false <- :gb_sets.is_empty(tree),
         {{time, _, key}, rest} when time <= now <- :gb_sets.take_smallest(tree) do
      due(rest, now, [key | keys])
    else
      _ -> {Enum.reverse(keys), tree}
    end
  end

  @doc "Throws away what is later than `final`."
  @spec cut(t(), Situ.Time.t()) :: t()
  def cut(%__MODULE__{tree: tree} = timers, final),
    do: %{timers | tree: :gb_sets.filter(fn {time, _, _} -> time <= final end, tree)}

  @spec next_time(t()) :: Situ.Time.t() | nil
  def next_time(%__MODULE__{tree: tree}),
    do: if(:gb_sets.is_empty(tree), do: nil, else: tree |> :gb_sets.smallest() |> elem(0))

  @doc "Whether no timer is set and no alarm."
  @spec idle?(t()) :: boolean()
  def idle?(%__MODULE__{alarm: nil, tree: tree}), do: :gb_sets.is_empty(tree)
  def idle?(%__MODULE__{}), do: false

  @doc "The alarm rang."
  @spec rang(t()) :: t()
  def rang(%__MODULE__{} = timers), do: %{timers | alarm: nil}

  @doc "Sets the alarm for what is due next (`nil`: nothing): `{:situ_alarm, due}` comes then."
  @spec arm(t(), Situ.Time.t() | nil, Clock.t()) :: t()
  def arm(%__MODULE__{alarm: nil} = timers, nil, _clock), do: timers
  def arm(%__MODULE__{} = timers, nil, _clock), do: disarm(timers)
  def arm(%__MODULE__{} = timers, due, clock), do: rearm(timers, due, Clock.wait_ms(clock, due))

  defp rearm(%{alarm: {due, wait, _}} = timers, due, wait) when wait != :never, do: timers
  defp rearm(timers, _due, :never), do: disarm(timers)

  defp rearm(timers, due, wait) do
    timer = Process.send_after(self(), {:situ_alarm, due}, wait)
    %{disarm(timers) | alarm: {due, wait, timer}}
  end

  defp disarm(%{alarm: nil} = timers), do: timers

  defp disarm(%{alarm: {_, _, timer}} = timers) do
    Process.cancel_timer(timer)
    %{timers | alarm: nil}
  end
end
