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

  alias Situ.{Interpolator, Message}

  @type side :: {[Message.t()], [[Message.t()]], Situ.Time.t() | nil, Situ.Time.t() | nil}
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
          sides: [side()],
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
      sides: Enum.map(interpolators, fn _ -> {[], [], nil, nil} end),
      give_up_after: opts[:give_up_after]
    }
  end

  @doc """
  Another secondary from now on, the last in order: primaries that wait and later ones need its value too. For components whose inputs
  become known only while they run. The creator is called as the new number of secondaries says (see above).
  """
  @spec add(t(), Interpolator.t()) :: t()
  def add(%__MODULE__{} = core, %Interpolator{} = interpolator) do
    interpolators = core.interpolators ++ [interpolator]
    %{core | interpolators: interpolators, sides: core.sides ++ [{[], [], nil, nil}]}
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

  def secondary(%{sides: [{front, rear, _last, closed}]} = core, 0, messages) do
    last = last_time(messages)
    awake(%{core | sides: [{front, [messages | rear], last, closed}]}, 0, last)
  end

  def secondary(core, index, messages) do
    last = last_time(messages)

    sides =
      List.update_at(core.sides, index, fn {front, rear, _last, closed} ->
        {front, [messages | rear], last, closed}
      end)

    awake(%{core | sides: sides}, index, last)
  end

  @doc "Secondary number `index` ended at `time`."
  @spec close(t(), non_neg_integer(), Situ.Time.t()) :: {[output()], t()}
  def close(core, index, time) do
    sides = List.update_at(core.sides, index, &put_elem(&1, 3, time))
    run(%{core | sides: sides, waiting: nil})
  end

  @doc "Which queue a decision waits for: a secondary's index, or `:primary`."
  @spec awaited(t()) :: :primary | non_neg_integer()
  def awaited(%{waiting: {index, _until}}), do: index
  def awaited(_core), do: :primary

  @doc "The sequence ids of the first messages that wait: of the primary, and of each secondary."
  @spec heads(t()) :: {non_neg_integer() | nil, [non_neg_integer() | nil]}
  def heads(core) do
    {head(core.front, core.rear), for({front, rear, _, _} <- core.sides, do: head(front, rear))}
  end

  defp head([%{sequence_id: id} | _], _rear), do: id
  defp head([], []), do: nil
  defp head([], rear), do: rear |> List.last() |> hd() |> Map.fetch!(:sequence_id)

  @doc "What waits: `%{primary: count, secondary: [count]}`, and how many primaries were given up on a stalled secondary."
  @spec queued(t()) :: %{
          primary: non_neg_integer(),
          secondary: [non_neg_integer()],
          given_up: non_neg_integer()
        }
  def queued(core) do
    %{
      primary: count(core.front, core.rear),
      secondary: Enum.map(core.sides, fn {front, rear, _, _} -> count(front, rear) end),
      given_up: core.given_up
    }
  end

  defp count(front, rear), do: length(front) + Enum.reduce(rear, 0, &(length(&1) + &2))

  defp last_time([message]), do: message.originating_time
  defp last_time([_ | rest]), do: last_time(rest)

  # A waiting primary is looked at again only when the stream that it waits for got far enough.
  defp awake(%{waiting: nil} = core, _index, _last), do: run(core)
  defp awake(%{waiting: {index, nil}} = core, index, _last), do: run(%{core | waiting: nil})

  defp awake(%{waiting: {index, until}} = core, index, last) when last >= until,
    do: run(%{core | waiting: nil})

  defp awake(core, _index, _last), do: {[], core}

  defp run(%{front: [], rear: []} = core), do: {[], core}

  defp run(%{front: [], rear: rear} = core), do: run(%{core | front: merge([], rear), rear: []})

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

    case ask(interpolator, time, side, limit) do
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
    case ask(interpolator, time, side, limit) do
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

  # The end of the queue is the end of what arrived only when nothing is left in `rear`: an interpolator that does not
  # wait, and any one asked about a closed stream, must see all.
  defp ask(interpolator, time, {_front, rear, last, closed} = side, limit) do
    closed = closed || if limit != nil and time < limit, do: last || time

    if rear != [] and (closed != nil or not interpolator.reproducible),
      do: answer(interpolator, time, merged(side), closed, limit),
      else: answer(interpolator, time, side, closed, limit)
  end

  defp answer(interpolator, time, {front, rear, _, _} = side, closed, limit) do
    %{module: module, config: config, default: default} = interpolator

    case module.interpolate(time, front, closed, config) do
      {:created, value, obsolete} ->
        {:created, value, trim(side, obsolete)}

      {:does_not_exist, obsolete} when default != :none ->
        {:created, elem(default, 1), trim(side, obsolete)}

      {:does_not_exist, obsolete} ->
        gone(side, obsolete, closed)

      _undecided when rear != [] ->
        ask(interpolator, time, merged(side), limit)

      {:wait, until} ->
        {:wait, until, side}

      :insufficient_data ->
        {:wait, nil, side}
    end
  end

  # Closed in earnest, or only for this primary because it waited too long.
  defp gone({_, _, _, nil} = side, obsolete, closed) when closed != nil,
    do: {:given_up, trim(side, obsolete)}

  defp gone(side, obsolete, _closed), do: {:does_not_exist, trim(side, obsolete)}

  defp merged({front, rear, last, closed}), do: {merge(front, rear), [], last, closed}

  defp merge([], [messages]), do: messages
  defp merge(front, rear), do: front ++ :lists.append(:lists.reverse(rear))

  defp trim(side, nil), do: side

  defp trim({front, rear, last, closed}, obsolete),
    do: {drop(front, obsolete), rear, last, closed}

  defp drop([%{originating_time: time} | rest], obsolete) when time < obsolete,
    do: drop(rest, obsolete)

  defp drop(front, _obsolete), do: front
end
