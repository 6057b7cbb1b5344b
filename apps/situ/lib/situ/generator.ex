defmodule Situ.Generator do
  @every [type: :integer, doc: "Interval between items, ns."]
  @align [type: :time_ns, doc: "Aligns times to this one, modulo `every:`."]
  @keep_open [type: :boolean, default: false, doc: "Stays open after the last item."]
  @count [
    type: {:or, [:non_neg_integer, {:in, [:infinity]}]},
    default: :infinity,
    doc: "Number of items."
  ]

  @single [keep_open: @keep_open]
  @paced [every: [required: true] ++ @every, count: @count, align: @align, keep_open: @keep_open]
  @enumerable [
    every: [
      type: :integer,
      doc: "Interval between items, ns. Without it, items contain their own times."
    ],
    align: @align,
    start: [
      type: :time_ns,
      doc: "Proposes a replay that begins at this time (for items with times)."
    ],
    keep_open: @keep_open
  ]
  @timer [
    every: [
      type: :pos_integer,
      required: true,
      doc: "Interval between messages, in ns of the clock."
    ],
    fun: [type: {:fun, 2}, doc: "Builds the data: `fun.(now, elapsed)`."]
  ]
  @events [
    unsubscribe: [
      type: {:fun, 1},
      doc: "Called at the end with the value returned by `subscribe`."
    ]
  ]

  @moduledoc """
  Sources from functions, values, enumerables, timers and events. All functions are also available on `Situ`:
  `Situ.from_enumerable/3` ...

      Situ.from_enumerable(p, 0..9, every: Situ.Time.ms(100))      # 0, 1 ... 9, a tenth of a second apart
      Situ.sequence(p, 1, &(&1 * 2), every: Situ.Time.ms(100))     # 1, 2, 4 ... endlessly
      Situ.from_enumerable(p, File.stream!("level.csv"), every: Situ.Time.ms(20))
      Situ.from_enumerable(p, [{10, :a}, {25, :b}])                # with times

      iex> replay = [replay: [interval: {0, 100}, speed: :max]]
      iex> Situ.to_list(fn p -> Situ.repeat(p, :tick, every: 30, align: 10) end, times: true, pipeline: replay)
      [{10, :tick}, {40, :tick}, {70, :tick}, {100, :tick}]

  Times are exact, however long it takes to produce the items: the pipeline's start, start + `every:`, and so on. With
  `align: time`, they are congruent to that time modulo `every:`, beginning at or after the start. Items are produced on
  demand up to the replay's end; in real time, each item is produced when its time comes.

  | generator | ends | reproducible |
  |---|---|---|
  | `sequence/4` and `repeat/3` with `count:`, `from_enumerable/3` | with the last item | yes |
  | the same with `keep_open: true` | never: they emit their items and stay open | yes |
  | `sequence/4` and `repeat/3` without `count:` | never | yes |
  | `timer/2`, `event_source/3` | never | no: times come from the clock |
  | `return/3` | after its single item | yes |

  A source that never ends does not keep a pipeline running after the finite sources have ended. The end of a replay
  ends all sources.

  In addition to the options of each function, all functions take the options of `Situ.Graph.Placement` for generators.
  """

  alias Situ.Graph.Placement
  alias Situ.{Argument, Pipeline, Stream}
  alias Situ.Generator.{Events, ItemFeed, Source, Timer}

  @doc """
  Emits `initial`, `next.(initial)`, and so on.

  #{Situ.Options.docs(@paced)}
  """
  @spec sequence(Pipeline.t(), value, (value -> value), keyword()) :: Stream.t()
        when value: term()
  def sequence(%Situ.Graph.Handle{} = p, initial, next, opts) when is_function(next, 1),
    do: add_paced_source(p, "Sequence", {initial, next}, opts)

  def sequence(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :handle,
        "Situ.sequence(p, 0, &(&1 + 1), every: Situ.Time.ms(20))"
      )

  @doc """
  Emits the same value repeatedly.

  #{Situ.Options.docs(@paced)}
  """
  @spec repeat(Pipeline.t(), term(), keyword()) :: Stream.t()
  def repeat(%Situ.Graph.Handle{} = p, value, opts),
    do: add_paced_source(p, "Repeat", {value, & &1}, opts)

  def repeat(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :handle, "Situ.repeat(p, 1, every: Situ.Time.ms(20))")

  @doc """
  Emits one value at the pipeline's start.

  #{Situ.Options.docs(@single)}
  """
  @spec return(Pipeline.t(), term(), keyword()) :: Stream.t()
  def return(p, value, opts \\ [])

  def return(%Situ.Graph.Handle{} = p, value, opts) do
    {own, placed} = Placement.split_options!(opts, @single, :generator)
    feed = fn start -> ItemFeed.build_paced({:sequence, value, & &1, 1}, start, 1, nil) end
    add_source(p, "Return", {Source, [feed: feed, keep_open: own[:keep_open]]}, placed)
  end

  def return(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :handle, "Situ.return(p, 1)")

  @doc """
  Emits the items of any enumerable. With `every:` (and `align:`) the items are values at that interval. Otherwise they
  are `{time, value}` pairs or messages, whose times must strictly increase. The enumerable is read lazily, so it may be
  infinite or expensive.

  Items before the requested or proposed start of the replay are skipped.

  #{Situ.Options.docs(@enumerable)}
  """
  @spec from_enumerable(Pipeline.t(), Enumerable.t(), keyword()) :: Stream.t()
  def from_enumerable(p, enumerable, opts \\ [])

  def from_enumerable(%Situ.Graph.Handle{} = p, enumerable, opts) do
    {own, placed} = Placement.split_options!(opts, @enumerable, :generator)
    if own[:start], do: Pipeline.propose_replay(p, {own[:start], :unbounded})
    placed = Keyword.put_new(placed, :type, item_type(enumerable))

    case own[:every] do
      nil ->
        feed = fn _start -> ItemFeed.build_timed(ItemFeed.to_items(enumerable)) end
        equal = placed[:on_same_time] != :error
        options = [feed: feed, timed: true, equal: equal, keep_open: own[:keep_open]]
        add_source(p, "Enumerable", {Source, options}, placed)

      every ->
        check_every!(every, known_max_count(enumerable))

        feed = fn start ->
          ItemFeed.build_paced(ItemFeed.to_items(enumerable), start, every, own[:align])
        end

        add_source(p, "Enumerable", {Source, [feed: feed, keep_open: own[:keep_open]]}, placed)
    end
  end

  def from_enumerable(other, _arg2, _arg3),
    do:
      Argument.raise_invalid!(
        other,
        :handle,
        "Situ.from_enumerable(p, 1..9, every: Situ.Time.ms(20))"
      )

  @doc """
  Emits a message every `every:` ns of the clock, with the clock's time. Its data is the time since the start (ns), or
  the result of `fun:`. Missed ticks are not emitted later.

  Reproducible: no. `repeat/3` has exact times, independent of the clock.

  #{Situ.Options.docs(@timer)}
  """
  @spec timer(Pipeline.t(), keyword()) :: Stream.t()
  def timer(%Situ.Graph.Handle{} = p, opts) do
    {own, placed} = Placement.split_options!(opts, @timer, :generator)
    type = if own[:fun], do: :any, else: :integer
    add_source(p, "Timer", {Timer, own}, Keyword.put_new(placed, :type, type))
  end

  def timer(other, _arg2),
    do: Argument.raise_invalid!(other, :handle, "Situ.timer(p, every: Situ.Time.ms(20))")

  @doc """
  Emits data that other processes post. When the pipeline starts, `subscribe.(post)` is called. Any process may then
  call `post.(data)`, which emits a message with the clock's time. Messages with the same time are separated by 1 ns
  unless `on_same_time:` is set.

  Reproducible: no, since times depend on when data is posted. Record the stream to replay it.

  #{Situ.Options.docs(@events)}
  """
  @spec event_source(Pipeline.t(), ((term() -> :ok) -> handle), keyword()) :: Stream.t()
        when handle: term()
  def event_source(p, subscribe, opts \\ [])

  def event_source(%Situ.Graph.Handle{} = p, subscribe, opts)
      when is_function(subscribe, 1) do
    opts = Keyword.put_new(opts, :on_same_time, :nudge)
    {own, placed} = Placement.split_options!(opts, @events, :generator)
    add_source(p, "EventSource", {Events, [subscribe: subscribe] ++ own}, placed)
  end

  def event_source(other, _arg2, _arg3),
    do:
      Argument.raise_invalid!(
        other,
        :handle,
        "Situ.event_source(p, fn post -> subscribe(post) end)"
      )

  defp add_paced_source(p, name, {initial, next}, opts) do
    {own, placed} = Placement.split_options!(opts, @paced, :generator)
    {every, count, align} = {own[:every], own[:count], own[:align]}
    check_every!(every, count)

    feed = fn start ->
      ItemFeed.build_paced({:sequence, initial, next, count}, start, every, align)
    end

    keep_open = own[:keep_open] or count == :infinity
    add_source(p, name, {Source, [feed: feed, keep_open: keep_open]}, placed)
  end

  defp add_source(p, name, {module, own}, placed) do
    {type, placed} = Keyword.pop(placed, :type, :any)
    placed = [default_name: name, outputs: [out: type]] ++ placed
    p |> Pipeline.add(module, own ++ placed) |> Situ.Node.output(:out)
  end

  # The number of items of a lazy enumerable is unknown.
  defp known_max_count(list) when is_list(list) and length(list) < 2, do: length(list)
  defp known_max_count(%Range{} = range), do: min(Range.size(range), 2)
  defp known_max_count(_enumerable), do: :infinity

  defp item_type(%Range{}), do: :integer
  defp item_type(_enumerable), do: :any

  defp check_every!(every, _count) when every > 0, do: :ok

  # Times must increase, which is always true of a single message.
  defp check_every!(_every, count) when count in [0, 1], do: :ok

  defp check_every!(every, _count) do
    raise ArgumentError,
          "every: must be an integer of at least 1 (ns), since messages are at least 1 ns apart, " <>
            "got: #{inspect(every)}"
  end
end
