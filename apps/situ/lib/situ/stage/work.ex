defmodule Situ.Stage.Work do
  @moduledoc false
  # The pending duties of a step besides taking messages, and the number of messages that it takes together.

  @quick_ns 100_000
  @slow_ns 1_000_000
  @most 4_096

  defstruct slice: 16,
            continue: :none,
            lingers: false,
            closings: [],
            ended: [],
            singly: 0,
            looked: nil,
            spent: {0, 0},
            time: 0,
            shortest: nil,
            failure: nil

  @typedoc """
  `slice` is how many messages are taken together. With `continue: {:some, term}`, the component continues with this
  term before it takes other messages. `closings` lists inputs that have closed since the last report; `lingers` is true
  if the component still has output left although they have. `ended` lists the closed inputs whose end has yet to be
  acknowledged to their producers. `singly` is the number of messages of a failed batch that
  are still to be handled one by one. `looked` is how many messages had been taken at the server's last check for
  progress. `spent` is the number of messages handled since the counts were published, and the ns that they took.
  `time` is the monotonic time (ns) at which that was last counted. `shortest` is the shortest time (ns) per message.
  `failure` is the error that ended the step.
  """
  @type t :: %__MODULE__{
          slice: pos_integer(),
          continue: :none | {:some, term()},
          lingers: boolean(),
          closings: [term()],
          ended: [Situ.Ports.Input.t()],
          singly: non_neg_integer(),
          looked: non_neg_integer() | nil,
          spent: {non_neg_integer(), integer()},
          time: integer(),
          shortest: non_neg_integer() | nil,
          failure: Situ.Error.t() | nil
        }

  @doc "Notes that `n` messages were handled, or posted by a source, in `elapsed` ns."
  @spec note_time(t(), non_neg_integer(), integer()) :: t()
  def note_time(%__MODULE__{} = work, 0, _elapsed), do: work

  # `nil` is more than any number.
  def note_time(%__MODULE__{shortest: shortest} = work, n, elapsed),
    do: %{work | shortest: min(div(elapsed, n), shortest)}

  @doc "Returns the shortest time (ns) per message since it was forgotten."
  @spec shortest_time(t()) :: non_neg_integer()
  def shortest_time(%__MODULE__{shortest: shortest}), do: shortest || 0

  @spec forget_shortest_time(t()) :: t()
  def forget_shortest_time(%__MODULE__{} = work), do: %{work | shortest: nil}

  @doc """
  Counts `n` messages, out of `taken`, that were handled together in `elapsed` ns until the monotonic time `time`. The
  slice grows while it is quick, and shrinks so that the next one takes about a millisecond.
  """
  @spec count_slice(t(), non_neg_integer(), pos_integer(), {integer(), integer()}) :: t()
  def count_slice(%__MODULE__{slice: slice, spent: {handled, ns}} = work, n, taken, times) do
    {elapsed, time} = times

    slice =
      cond do
        n < taken -> max(div(n, 5), 1)
        elapsed > @slow_ns and slice > 1 -> div(slice, 2)
        elapsed < @quick_ns and n >= slice and slice < @most -> slice * 2
        true -> slice
      end

    work = %{work | slice: slice, spent: {handled + n, ns + elapsed}, time: time}
    note_time(work, n, elapsed)
  end

  @doc "Adds an input that has closed."
  @spec add_closing(t(), term()) :: t()
  def add_closing(%__MODULE__{closings: closings} = work, closing),
    do: %{work | closings: closings ++ [closing]}

  @doc "Returns whether the component has more output for the messages it has received."
  @spec unfinished?(t()) :: boolean()
  def unfinished?(%__MODULE__{lingers: lingers?, continue: continue}),
    do: lingers? or continue != :none
end
