defmodule Situ.Fusion.Core do
  @moduledoc """
  The pure heart of fusion: one queue of primary messages, one per secondary stream, and the rule that pairs them.

  Whenever something arrives, the oldest primary is asked for: each secondary's interpolator gives a value at its time.

    * All have one: an output at the primary's originating time.
    * One cannot say yet: the primary waits, and later ones behind it, so outputs come in the primaries' order.
    * One has none: the primary is given up.

  Secondary messages that no later primary can need are dropped at once, so memory is bounded by what is undecided.

      iex> core = Situ.Fusion.Core.new([Situ.Reproducible.exact()], &{&1, &2})
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {[], core} = Situ.Fusion.Core.primary(core, [message.(1, :a), message.(2, :b)])
      iex> {outputs, _core} = Situ.Fusion.Core.secondary(core, 0, [message.(2, :x)])
      iex> outputs
      [{:out, 2, {:b, :x}}]

  With one secondary the creator is called `creator.(primary, value)`, else `creator.(primary, [value])`.
  """

  alias Situ.Fusion.Side
  alias Situ.{Interpolator, Message}

  @type output :: {:out, Situ.Time.t(), term()}

  @enforce_keys [:interpolators, :creator, :sides]
  defstruct [
    :interpolators,
    :creator,
    :sides,
    :give_up_after,
    front: [],
    rear: [],
    newest: nil,
    waiting: nil,
    given_up: 0
  ]

  @type t :: %__MODULE__{
          interpolators: [Interpolator.t()],
          creator: fun(),
          sides: [Side.t()],
          give_up_after: Situ.Time.duration() | nil,
          front: [Message.t()],
          rear: [[Message.t()]],
          newest: Situ.Time.t() | nil,
          waiting: nil | {non_neg_integer(), Situ.Time.t() | :infinity | nil},
          given_up: non_neg_integer()
        }

  @doc """
  A core with one interpolator per secondary.

  `give_up_after:` (ns): a primary that still waits when a primary this much later has arrived is decided as if the secondary
  streams had ended. It bounds memory when a secondary falls silent, and makes the result depend on timing.
  """
  @spec new([Interpolator.t()], fun(), keyword()) :: t()
  def new(interpolators, creator, opts \\ []) do
    %__MODULE__{
      interpolators: interpolators,
      creator: creator,
      sides: Enum.map(interpolators, fn _ -> Side.new() end),
      give_up_after: opts[:give_up_after]
    }
  end

  @doc "Primary messages arrived."
  @spec primary(t(), [Message.t()]) :: {[output()], t()}
  def primary(core, []), do: {[], core}

  def primary(%{sides: []} = core, messages) do
    {for(m <- messages, do: {:out, m.originating_time, core.creator.(m.data, [])}), core}
  end

  def primary(%{give_up_after: nil} = core, messages) do
    core = %{core | rear: [messages | core.rear]}
    if core.waiting == nil, do: run(core), else: {[], core}
  end

  def primary(core, messages) do
    newest = List.last(messages).originating_time
    run(%{core | rear: [messages | core.rear], newest: newest, waiting: nil})
  end

  @doc "Messages of secondary number `index` (from 0) arrived."
  @spec secondary(t(), non_neg_integer(), [Message.t()]) :: {[output()], t()}
  def secondary(core, _index, []), do: {[], core}

  def secondary(%{sides: [side]} = core, 0, messages) do
    side = Side.push(side, messages)
    awake(%{core | sides: [side]}, 0, Side.reached(side))
  end

  def secondary(core, index, messages) do
    side = core.sides |> Enum.at(index) |> Side.push(messages)
    awake(%{core | sides: List.replace_at(core.sides, index, side)}, index, Side.reached(side))
  end

  @doc "Secondary number `index` ended at `time`."
  @spec close(t(), non_neg_integer(), Situ.Time.t()) :: {[output()], t()}
  def close(core, index, time) do
    sides = List.update_at(core.sides, index, &Side.close(&1, time))
    run(%{core | sides: sides, waiting: nil})
  end

  @doc "Which queue a decision waits for: a secondary's index, or `:primary`."
  @spec awaited(t()) :: :primary | non_neg_integer()
  def awaited(%{waiting: {index, _until}}), do: index
  def awaited(_core), do: :primary

  @doc "The sequence ids of the first messages that wait: of the primary, and of each secondary."
  @spec heads(t()) :: {non_neg_integer() | nil, [non_neg_integer() | nil]}
  def heads(core) do
    {Side.first(core.front, core.rear), Enum.map(core.sides, &Side.head/1)}
  end

  @doc "What waits: `%{primary: count, secondary: [count]}`, and how many primaries were given up on a stalled secondary."
  @spec queued(t()) :: %{
          primary: non_neg_integer(),
          secondary: [non_neg_integer()],
          given_up: non_neg_integer()
        }
  def queued(core) do
    %{
      primary: Side.count(core.front, core.rear),
      secondary: Enum.map(core.sides, &Side.count/1),
      given_up: core.given_up
    }
  end

  # A waiting primary is looked at again only when the stream that it waits for got far enough.
  defp awake(%{waiting: nil} = core, _index, _last), do: run(core)
  defp awake(%{waiting: {index, nil}} = core, index, _last), do: run(%{core | waiting: nil})

  defp awake(%{waiting: {index, until}} = core, index, last) when last >= until,
    do: run(%{core | waiting: nil})

  defp awake(core, _index, _last), do: {[], core}

  defp run(%{front: [], rear: []} = core), do: {[], core}

  defp run(%{front: [], rear: rear} = core),
    do: run(%{core | front: Side.merge([], rear), rear: []})

  defp run(%{sides: [side], interpolators: [interpolator]} = core) do
    {front, side, waiting, outputs, given_up} =
      single(core.front, side, interpolator, {core.creator, limit(core)}, [], core.given_up)

    finish(core, front, [side], waiting, outputs, given_up)
  end

  defp run(core) do
    {front, sides, waiting, outputs, given_up} =
      several(core.front, core.sides, core, limit(core), [], core.given_up)

    finish(core, front, sides, waiting, outputs, given_up)
  end

  defp finish(%{rear: []} = core, front, sides, waiting, outputs, given_up) do
    core = %{core | front: front, sides: sides, waiting: waiting, given_up: given_up}
    {:lists.reverse(outputs), core}
  end

  defp finish(core, [], sides, nil, outputs, given_up) do
    {more, core} = run(%{core | front: [], sides: sides, waiting: nil, given_up: given_up})
    {:lists.reverse(outputs, more), core}
  end

  defp finish(core, front, sides, waiting, outputs, given_up) do
    core = %{core | front: front, sides: sides, waiting: waiting, given_up: given_up}
    {:lists.reverse(outputs), core}
  end

  # Primaries before this time wait no longer.
  defp limit(%{give_up_after: nil}), do: nil
  defp limit(%{newest: nil}), do: nil
  defp limit(core), do: core.newest - core.give_up_after

  # One secondary: the common case, without lists of sides.
  defp single([], side, _interpolator, _context, outputs, given_up),
    do: {[], side, nil, outputs, given_up}

  defp single([primary | rest] = front, side, interpolator, context, outputs, given_up) do
    {creator, limit} = context
    time = primary.originating_time

    case Side.ask(interpolator, time, side, limit) do
      {:created, value, side} ->
        output = {:out, time, creator.(primary.data, value)}
        single(rest, side, interpolator, context, [output | outputs], given_up)

      {:does_not_exist, side} ->
        single(rest, side, interpolator, context, outputs, given_up)

      {:given_up, side} ->
        single(rest, side, interpolator, context, outputs, given_up + 1)

      {:wait, until, side} ->
        {front, side, {0, until}, outputs, given_up}
    end
  end

  defp several([], sides, _core, _limit, outputs, given_up),
    do: {[], sides, nil, outputs, given_up}

  defp several([primary | rest] = front, sides, core, limit, outputs, given_up) do
    time = primary.originating_time

    case ask_all(core.interpolators, sides, time, limit, 0, [], []) do
      {:all, values, sides} ->
        output = {:out, time, core.creator.(primary.data, values)}
        several(rest, sides, core, limit, [output | outputs], given_up)

      {:none, sides} ->
        several(rest, sides, core, limit, outputs, given_up)

      {:given_up, sides} ->
        several(rest, sides, core, limit, outputs, given_up + 1)

      # The same primary is asked for again: its secondaries must be as they were.
      {:wait, waiting} ->
        {front, sides, waiting, outputs, given_up}
    end
  end

  # Values of all secondaries in order. Each queue is trimmed as its own answer allows even when another one has
  # no value, since a trimmed message is one that later primaries cannot need either.
  defp ask_all([], [], _time, _limit, _index, values, done),
    do: {:all, :lists.reverse(values), :lists.reverse(done)}

  defp ask_all([interpolator | interpolators], [side | sides], time, limit, index, values, done) do
    case Side.ask(interpolator, time, side, limit) do
      {:created, value, side} ->
        ask_all(interpolators, sides, time, limit, index + 1, [value | values], [side | done])

      {:does_not_exist, side} ->
        {:none, :lists.reverse(done, [side | sides])}

      {:given_up, side} ->
        {:given_up, :lists.reverse(done, [side | sides])}

      {:wait, until, _side} ->
        {:wait, {index, until}}
    end
  end
end
