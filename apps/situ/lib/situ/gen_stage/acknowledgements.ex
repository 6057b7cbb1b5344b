defmodule Situ.GenStage.Acknowledgements do
  @moduledoc false
  # Decides which events have succeeded and which have failed, from the times of the events and the times at which
  # messages have arrived at the end. Pure.
  #
  # The times of both increase. An event with a message at its time has succeeded. Once a later message has arrived, an
  # event without one is missing: nothing earlier can still arrive.

  @enforce_keys [:missing]
  defstruct [:missing, :last_event, :reached, events: :queue.new(), times: :queue.new()]

  @typedoc "The event's originating time, the event, and the clock time at which it arrived."
  @type event :: {Situ.Time.t(), term(), Situ.Time.t()}
  @typedoc """
  `times` are the times of messages whose events may not have arrived yet; `last_event` and `reached` are the last times
  of both.
  """
  @type t :: %__MODULE__{
          missing: :failed | :successful,
          last_event: Situ.Time.t() | nil,
          reached: Situ.Time.t() | nil,
          events: :queue.queue(event()),
          times: :queue.queue(Situ.Time.t())
        }
  @type result :: {successful :: [term()], failed :: [term()], t()}

  @spec new(:failed | :successful) :: t()
  def new(missing), do: %__MODULE__{missing: missing}

  @doc "Adds events, in the order of their times."
  @spec add_events(t(), [event(), ...]) :: result()
  def add_events(%__MODULE__{} = state, events) do
    {last, _event, _arrived} = List.last(events)
    queue = Enum.reduce(events, state.events, &:queue.in/2)
    match_events(%{state | events: queue, last_event: last})
  end

  @doc "Adds the times of messages that have arrived at the end, in order."
  @spec add_times(t(), [Situ.Time.t(), ...]) :: result()
  def add_times(%__MODULE__{} = state, times) do
    queue = Enum.reduce(times, state.times, &:queue.in/2)
    match_events(%{state | times: queue, reached: List.last(times)})
  end

  @doc "Fails the events that arrived until clock time `until` and have had no result."
  @spec fail_events(t(), Situ.Time.t()) :: result()
  def fail_events(%__MODULE__{} = state, until), do: fail_events(state, until, [])

  defp fail_events(state, until, failed) do
    case :queue.peek(state.events) do
      {:value, {_time, event, arrived}} when arrived <= until ->
        fail_events(%{state | events: :queue.drop(state.events)}, until, [event | failed])

      _ ->
        {[], Enum.reverse(failed), state}
    end
  end

  @doc "Returns the clock time at which the first waiting event arrived, or `nil`."
  @spec first_arrival(t()) :: Situ.Time.t() | nil
  def first_arrival(%__MODULE__{events: events}) do
    case :queue.peek(events) do
      {:value, {_time, _event, arrived}} -> arrived
      :empty -> nil
    end
  end

  @spec count_events(t()) :: non_neg_integer()
  def count_events(%__MODULE__{events: events}), do: :queue.len(events)

  defp match_events(state), do: match_events(state, [], [])

  defp match_events(%{events: events, times: times} = state, good, bad) do
    case {:queue.peek(events), :queue.peek(times)} do
      {{:value, {time, event, _}}, {:value, time}} ->
        state = %{state | events: :queue.drop(events), times: :queue.drop(times)}
        match_events(state, [event | good], bad)

      {{:value, {at, _, _}}, {:value, time}} when time < at ->
        match_events(%{state | times: :queue.drop(times)}, good, bad)

      {{:value, {at, event, _}}, _later} when state.reached != nil and state.reached >= at ->
        state = %{state | events: :queue.drop(events)}

        if state.missing == :failed,
          do: match_events(state, good, [event | bad]),
          else: match_events(state, [event | good], bad)

      {:empty, {:value, time}} when state.last_event != nil and time <= state.last_event ->
        match_events(%{state | times: :queue.drop(times)}, good, bad)

      _nothing_more ->
        {Enum.reverse(good), Enum.reverse(bad), state}
    end
  end
end
