defmodule Situ.Stage.Pace do
  @moduledoc false
  # How much a stage does in one go: the slice of messages, whether another turn is on its way, the size of the heap.

  @many 64
  @wide_words 32_768
  @quick_ns 100_000
  @slow_ns 1_000_000
  @most 512

  defstruct slice: 16,
            scheduled: false,
            wide: false,
            early: [],
            quitting: false,
            continue: :none,
            lingers: false,
            closings: [],
            singly: 0,
            looked: nil

  @typedoc """
  `early`: plain messages that came before the stage ran, newest first. `quitting`: it ends once its outputs are
  drained. `continue`: the component goes on with this, `{:some, term}`, before it takes anything else in;
  `closings`: inputs that have closed meanwhile; `lingers`: it has something left for later, although they have.
  `singly`: how many messages of a batch that failed are still to be taken one by one.
  `looked`: how much it had taken when the server looked last whether it comes to an end.
  """
  @type t :: %__MODULE__{
          slice: pos_integer(),
          scheduled: boolean(),
          wide: boolean(),
          early: [term()],
          quitting: boolean(),
          continue: :none | {:some, term()},
          lingers: boolean(),
          closings: [term()],
          singly: non_neg_integer(),
          looked: non_neg_integer() | nil
        }

  @doc "Another turn, after what is in the mailbox."
  @spec schedule(t()) :: t()
  def schedule(%__MODULE__{scheduled: true} = pace), do: pace

  def schedule(%__MODULE__{} = pace) do
    send(self(), :situ_turn)
    %{pace | scheduled: true}
  end

  @doc """
  Slices grow while they are quick, and shrink when they are slow: `n` messages took `elapsed` ns.
  """
  @spec resize(t(), non_neg_integer(), integer()) :: t()
  def resize(%__MODULE__{wide: false} = pace, n, elapsed) when n >= @many,
    do: pace |> widen(n) |> resize(n, elapsed)

  def resize(%__MODULE__{slice: slice} = pace, n, elapsed) do
    cond do
      elapsed > @slow_ns and slice > 1 -> %{pace | slice: div(slice, 2)}
      elapsed < @quick_ns and n == slice and slice < @most -> %{pace | slice: slice * 2}
      true -> pace
    end
  end

  @doc "A batch took too long after `n` messages: the next one is to take a millisecond or so."
  @spec slow(t(), pos_integer()) :: t()
  def slow(%__MODULE__{} = pace, n), do: %{pace | slice: max(div(n, 5), 1)}

  @doc """
  A stage that handles many messages at once is given a heap that holds them, once: they would otherwise be copied by
  one collection after another.
  """
  @spec widen(t(), non_neg_integer() | :infinity) :: t()
  def widen(%__MODULE__{wide: false} = pace, n) when n >= @many do
    Process.flag(:min_heap_size, @wide_words)
    %{pace | wide: true}
  end

  def widen(%__MODULE__{} = pace, _messages), do: pace
end
