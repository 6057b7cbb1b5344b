defmodule Situ.Store.Pieces.Cut do
  @moduledoc false
  # Where a recording in pieces is cut: at multiples of a time, or where a piece has got so many bytes. The second is
  # found while it is recorded, by one process, and read by all that write: the number of the newest piece and the time
  # from which on messages belong to it.
  @enforce_keys [:every]
  defstruct [:every, :newest]

  @type t :: %__MODULE__{
          every: pos_integer() | {:bytes, pos_integer()},
          newest: :atomics.atomics_ref() | nil
        }

  @number 1
  @from 2
  @before_all -0x8000000000000000

  @spec new(pos_integer() | {:bytes, pos_integer()}) :: t()
  def new({:bytes, _} = every) do
    newest = :atomics.new(2, signed: true)
    :atomics.put(newest, @from, @before_all)
    %__MODULE__{every: every, newest: newest}
  end

  def new(every), do: %__MODULE__{every: every}

  @doc "The number of the piece that a time belongs to: that of the newest, and of the one before it what lies before."
  @spec number(t(), Situ.Time.t()) :: integer()
  def number(%{newest: nil, every: every}, time), do: Integer.floor_div(time, every)

  def number(%{newest: newest}, time) do
    # In this order, and set in the other: a number that is older than its time would send a message two pieces back.
    from = :atomics.get(newest, @from)
    number = :atomics.get(newest, @number)
    if time >= from, do: number, else: number - 1
  end

  @doc "The number of the newest piece that was begun by `cut/2`."
  @spec newest(t()) :: integer()
  def newest(%{newest: newest}), do: :atomics.get(newest, @number)

  @doc """
  Moves the beginning of the newest piece back to `time`, if it is later: it may have come from a message with a wrong
  time, and then the piece before it would never end.
  """
  @spec lower(t(), Situ.Time.t()) :: :ok
  def lower(%{newest: newest}, time) do
    if time < :atomics.get(newest, @from), do: :atomics.put(newest, @from, time), else: :ok
  end

  @doc "From `time` on a new piece."
  @spec cut(t(), Situ.Time.t()) :: :ok
  def cut(%{newest: newest}, time) do
    :atomics.add(newest, @number, 1)
    :atomics.put(newest, @from, time)
  end
end
