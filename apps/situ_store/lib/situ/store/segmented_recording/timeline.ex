defmodule Situ.Store.SegmentedRecording.Timeline do
  @moduledoc false
  # Orders the parts of one stream, one per segment, by time. Pure.
  #
  # Within a run of the recorder, the times of a stream only increase, although its segments may have been created in
  # another order. A later run may begin before an earlier one has ended, for example after the clock was set back or if
  # a replay was recorded again. The later run takes precedence: messages of earlier runs at or after its first message
  # are not part of the recording, and `hidden` counts them.

  # A part begins at the ordinal `base`. `last` is the time of its last visible message. Messages from `until` on are
  # hidden.
  defmodule Part do
    @moduledoc false
    # The messages of a stream in one segment.
    @enforce_keys [:number, :run, :id, :count, :first, :last]
    defstruct [:number, :run, :id, :count, :first, :last, :until, base: 0]
    @type t :: %__MODULE__{}
  end

  # `parts` begins with the latest part.
  defstruct parts: [], next: 0, hidden: 0, hidden_parts: []

  @type t :: %__MODULE__{
          parts: [Part.t()],
          next: non_neg_integer(),
          hidden: non_neg_integer(),
          hidden_parts: [integer()]
        }

  @doc """
  Adds the part that was written last. `count_before.(part, time)` returns how many of a part's messages are earlier
  than `time`. With `dense?`, hidden messages have no ordinals. Otherwise later ordinals do not change.
  """
  @spec add_part(t(), Part.t(), (Part.t(), Situ.Time.t() -> non_neg_integer()), boolean()) :: t()
  def add_part(timeline, part, count_before, dense?) do
    base = next_ordinal(timeline)
    {kept, hidden} = hide_from(timeline.parts, part, count_before)
    base = if dense? and hidden > 0, do: end_of_parts(kept), else: base
    parts = [%{part | base: base} | kept]
    count = if hidden > 0, do: length(timeline.parts) - length(kept), else: 0
    gone = for part <- Enum.take(timeline.parts, count), do: part.number

    %{
      timeline
      | parts: parts,
        hidden: timeline.hidden + hidden,
        hidden_parts: gone ++ timeline.hidden_parts
    }
  end

  @doc "Returns whether the part of a segment was added, even if all of its messages are hidden now."
  @spec known_part?(t(), integer()) :: boolean()
  def known_part?(timeline, number),
    do: number in timeline.hidden_parts or Enum.any?(timeline.parts, &(&1.number == number))

  defp hide_from([%{run: run} | _] = parts, %{run: run}, _count_before), do: {parts, 0}

  defp hide_from([%{last: last} = part | earlier], %{first: first} = new, count_before)
       when last >= first do
    case count_before.(part, first) do
      0 ->
        {kept, hidden} = hide_from(earlier, new, count_before)
        {kept, hidden + part.count}

      n ->
        {[%{part | count: n, until: first, last: first - 1} | earlier], part.count - n}
    end
  end

  defp hide_from(parts, _new, _count_before), do: {parts, 0}

  defp end_of_parts([]), do: 0
  defp end_of_parts([%{base: base, count: count} | _]), do: base + count

  @doc "Returns the ordinal after the last message."
  @spec next_ordinal(t()) :: non_neg_integer()
  def next_ordinal(%{parts: parts, next: next}), do: max(end_of_parts(parts), next)

  @doc "Sets the count and the last time of a part that is being written."
  @spec update_part(t(), Part.t()) :: t()
  def update_part(timeline, new), do: %{timeline | parts: replace_part(timeline.parts, new)}

  defp replace_part([%{number: number, until: nil} = part | rest], %{number: number} = new),
    do: [%{part | id: new.id, count: new.count, last: new.last} | rest]

  defp replace_part([part | rest], new), do: [part | replace_part(rest, new)]
  defp replace_part([], _new), do: []

  @doc "Removes the part of a deleted segment. The ordinals of the others do not change."
  @spec remove_part(t(), integer()) :: t()
  def remove_part(timeline, number) do
    next = next_ordinal(timeline)

    %{
      timeline
      | parts: Enum.reject(timeline.parts, &(&1.number == number)),
        hidden_parts: List.delete(timeline.hidden_parts, number),
        next: next
    }
  end

  @doc "Returns the index of the part that contains an ordinal, or the first part after it."
  @spec find_ordinal(tuple(), non_neg_integer()) :: non_neg_integer()
  def find_ordinal(parts, ordinal) do
    index = max(search(parts, &(&1.base <= ordinal)) - 1, 0)
    part = elem(parts, index)
    last? = index == tuple_size(parts) - 1
    if not last? and ordinal >= part.base + part.count, do: index + 1, else: index
  end

  @doc "Returns the index of the first part with messages at or after a time, or the number of parts."
  @spec find_time(tuple(), Situ.Time.t()) :: non_neg_integer()
  def find_time(parts, time), do: search(parts, &(&1.last < time))

  @doc "Returns the last part that begins at or before a time, or `nil`."
  @spec find_latest(tuple(), Situ.Time.t()) :: Part.t() | nil
  def find_latest(parts, time) do
    case search(parts, &(&1.first <= time)) do
      0 -> nil
      n -> elem(parts, n - 1)
    end
  end

  # Returns the number of parts at the beginning for which `before?` is true.
  defp search(parts, before?), do: search(parts, before?, 0, tuple_size(parts))
  defp search(_parts, _before?, low, low), do: low

  defp search(parts, before?, low, high) do
    middle = div(low + high, 2)

    if before?.(elem(parts, middle)),
      do: search(parts, before?, middle + 1, high),
      else: search(parts, before?, low, middle)
  end
end
