defmodule Situ.Store.Rotation.SplitPoint do
  @moduledoc false
  # Decides where a recording is split into segments: at multiples of a time, or when a segment reaches a size. One
  # process makes the splits by size during recording. All writing components read the split point: the number of the
  # newest segment and the time at which it begins.
  @enforce_keys [:every]
  defstruct [:every, :newest]

  @type t :: %__MODULE__{
          every: pos_integer() | {:bytes, pos_integer()},
          newest: :atomics.atomics_ref() | nil
        }

  # The beginning of segment n is in slot 2 or 3, by turns. Each slot is written before the number that uses it, and a
  # reader that sees the number change reads again, so a number never meets the beginning of another segment.
  @number 1
  @before_all -0x8000000000000000

  @spec new(pos_integer() | {:bytes, pos_integer()}) :: t()
  def new({:bytes, _} = every) do
    newest = :atomics.new(3, signed: true)
    :atomics.put(newest, slot(0), @before_all)
    %__MODULE__{every: every, newest: newest}
  end

  def new(every), do: %__MODULE__{every: every}

  @doc "Returns the number of the segment for a time: the newest segment or, for earlier times, the one before it."
  @spec segment_number(t(), Situ.Time.t()) :: integer()
  def segment_number(%{newest: nil, every: every}, time), do: Integer.floor_div(time, every)

  def segment_number(%{newest: newest} = split_point, time) do
    number = :atomics.get(newest, @number)
    from = :atomics.get(newest, slot(number))

    cond do
      :atomics.get(newest, @number) != number -> segment_number(split_point, time)
      time >= from -> number
      true -> number - 1
    end
  end

  @doc "Returns the number of the newest segment begun by `begin_segment/2`."
  @spec newest_number(t()) :: integer()
  def newest_number(%{newest: newest}), do: :atomics.get(newest, @number)

  @doc """
  Moves the beginning of the newest segment back to `time`, if it is later. A message with an incorrect time may have
  set it, and then the segment before it would never end.
  """
  @spec lower_start(t(), Situ.Time.t()) :: :ok
  def lower_start(%{newest: newest}, time) do
    slot = slot(:atomics.get(newest, @number))
    if time < :atomics.get(newest, slot), do: :atomics.put(newest, slot, time), else: :ok
  end

  @doc "Begins a new segment at `time`."
  @spec begin_segment(t(), Situ.Time.t()) :: :ok
  def begin_segment(%{newest: newest}, time) do
    number = :atomics.get(newest, @number) + 1
    :atomics.put(newest, slot(number), time)
    :atomics.put(newest, @number, number)
  end

  defp slot(number), do: 2 + rem(number, 2)
end
