defmodule Situ.Generator do
  @every [type: :integer, doc: "ns from one item to the next."]
  @align [type: :time_ns, doc: "Times congruent to this one, modulo `every:`."]
  @keep_open [type: :boolean, default: false, doc: "Stay open after the last item."]
  @count [
    type: {:or, [:non_neg_integer, {:in, [:infinity]}]},
    default: :infinity,
    doc: "How many items."
  ]

  @paced [every: [required: true] ++ @every, count: @count, align: @align, keep_open: @keep_open]
  @enumerable [
    every: [
      type: :integer,
      doc: "ns from one item to the next; without it items bring their times."
    ],
    align: @align,
    start: [type: :time_ns, doc: "Proposes a replay from this time on (items with times)."],
    keep_open: @keep_open
  ]
  @timer [
    every: [
      type: :pos_integer,
      required: true,
      doc: "ns of the clock from one message to the next."
    ],
    fun: [type: {:fun, 2}, doc: "Makes the data: `fun.(now, elapsed)`."]
  ]
  @events [
    unsubscribe: [
      type: {:fun, 1},
      doc: "Called at the end, with the value that `subscribe` returned."
    ]
  ]

  @moduledoc """
  Sources made of functions, values, enumerables, timers and events. All are on `Situ` too: `Situ.from_enumerable/3` ...

      Situ.from_enumerable(p, 0..9, every: Situ.Time.ms(100))      # 0, 1 ... 9, a tenth of a second apart
      Situ.sequence(p, 1, &(&1 * 2), every: Situ.Time.ms(100))     # 1, 2, 4 ... without end
      Situ.from_enumerable(p, File.stream!("level.csv"), every: Situ.Time.ms(20))
      Situ.from_enumerable(p, [{10, :a}, {25, :b}])                # with times

      iex> replay = [replay: [interval: {0, 100}, speed: :max]]
      iex> Situ.to_list(fn p -> Situ.repeat(p, :tick, every: 30, align: 10) end, times: true, pipeline: replay)
      [{10, :tick}, {40, :tick}, {70, :tick}, {100, :tick}]

  Times are exact: the pipeline's start, start + `every:` ..., however long it takes to make them. With `align:
  time` they are the times congruent to it modulo `every:`, from the first one at or after the start. Items are made
  as they are asked for, in real time when their time comes, and up to the replay's end.

  | generator | ends | reproducible |
  |---|---|---|
  | `sequence/4` and `repeat/3` with `count:`, `from_enumerable/3` | with the last item | yes |
  | the same with `keep_open: true`, `once/3` | never: they give what they have and stay open | yes |
  | `sequence/4` and `repeat/3` without `count:` | never | yes |
  | `timer/2`, `event_source/3` | never | no: times are the clock's |
  | `return/3` | after its one item | yes |

  A source that never ends does not keep a pipeline running once the finite ones have ended; a replay's end ends all
  of them.

  Besides the options named with each function, all take those of `Situ.Graph.Placement` for generators.
  """

  alias Situ.Graph.Placement
  alias Situ.{Argument, Pipeline, Stream}
  alias Situ.Generator.{Events, Feed, Source, Timer}

  @doc """
  `initial`, `next.(initial)`, and so on.

  #{Situ.Options.docs(@paced)}
  """
  @spec sequence(Pipeline.t(), value, (value -> value), keyword()) :: Stream.t()
        when value: term()
  def sequence(%Situ.Graph.Handle{} = p, initial, next, opts) when is_function(next, 1),
    do: paced(p, "Sequence", {initial, next}, opts)

  def sequence(other, _arg2, _arg3, _arg4),
    do:
      Argument.refuse!(other, :handle, "Situ.sequence(p, 0, &(&1 + 1), every: Situ.Time.ms(20))")

  @doc """
  The same value again and again.

  #{Situ.Options.docs(@paced)}
  """
  @spec repeat(Pipeline.t(), term(), keyword()) :: Stream.t()
  def repeat(%Situ.Graph.Handle{} = p, value, opts), do: paced(p, "Repeat", {value, & &1}, opts)

  def repeat(other, _arg2, _arg3),
    do: Argument.refuse!(other, :handle, "Situ.repeat(p, 1, every: Situ.Time.ms(20))")

  @doc "One value at the pipeline's start, and that was all."
  @spec return(Pipeline.t(), term(), keyword()) :: Stream.t()
  def return(p, value, opts \\ [])

  def return(%Situ.Graph.Handle{} = p, value, opts),
    do: single(p, "Return", value, false, opts)

  def return(other, _arg2, _arg3), do: Argument.refuse!(other, :handle, "Situ.return(p, 1)")

  @doc "One value at the pipeline's start; the stream stays open."
  @spec once(Pipeline.t(), term(), keyword()) :: Stream.t()
  def once(p, value, opts \\ [])

  def once(%Situ.Graph.Handle{} = p, value, opts), do: single(p, "Once", value, true, opts)

  def once(other, _arg2, _arg3), do: Argument.refuse!(other, :handle, "Situ.once(p, 1)")

  @doc """
  The items of any enumerable: with `every:` (and `align:`) values that far apart, else `{time, value}` pairs or
  messages, whose times must strictly increase. Read lazily, so endless and costly enumerables are fine.

  Items before the replay's start, asked for or proposed, are passed over.

  #{Situ.Options.docs(@enumerable)}
  """
  @spec from_enumerable(Pipeline.t(), Enumerable.t(), keyword()) :: Stream.t()
  def from_enumerable(p, enumerable, opts \\ [])

  def from_enumerable(%Situ.Graph.Handle{} = p, enumerable, opts) do
    {own, placed} = Placement.split!(opts, @enumerable, :generator)
    if own[:start], do: Pipeline.propose_replay(p, {own[:start], :unbounded})
    placed = Keyword.put_new(placed, :type, type(enumerable))

    case own[:every] do
      nil ->
        feed = fn _start -> Feed.timed(Feed.items(enumerable)) end
        equal = placed[:on_same_time] != :error
        options = [feed: feed, timed: true, equal: equal, keep_open: own[:keep_open]]
        add(p, "Enumerable", {Source, options}, placed)

      every ->
        check_every!(every, at_most(enumerable))
        feed = fn start -> Feed.paced(Feed.items(enumerable), start, every, own[:align]) end
        add(p, "Enumerable", {Source, [feed: feed, keep_open: own[:keep_open]]}, placed)
    end
  end

  def from_enumerable(other, _arg2, _arg3),
    do: Argument.refuse!(other, :handle, "Situ.from_enumerable(p, 1..9, every: Situ.Time.ms(20))")

  @doc """
  A message whenever `every:` ns of the clock have passed, stamped with the clock; its data is the time since the
  start (ns), or that of `fun:`. Ticks that were missed are not made up for.

  Reproducible: no. `repeat/3` gives exact times, whatever the clock does.

  #{Situ.Options.docs(@timer)}
  """
  @spec timer(Pipeline.t(), keyword()) :: Stream.t()
  def timer(%Situ.Graph.Handle{} = p, opts) do
    {own, placed} = Placement.split!(opts, @timer, :generator)
    type = if own[:fun], do: :any, else: :integer
    add(p, "Timer", {Timer, own}, Keyword.put_new(placed, :type, type))
  end

  def timer(other, _arg2),
    do: Argument.refuse!(other, :handle, "Situ.timer(p, every: Situ.Time.ms(20))")

  @doc """
  Data that other processes post. When the pipeline starts `subscribe.(post)` is called; any process may then call
  `post.(data)`, which makes a message, stamped with the clock. Two messages of the same time are set 1 ns apart
  unless `on_same_time:` says otherwise.

  Reproducible: no, the times are those of posting. Record the stream to replay it.

  #{Situ.Options.docs(@events)}
  """
  @spec event_source(Pipeline.t(), ((term() -> :ok) -> handle), keyword()) :: Stream.t()
        when handle: term()
  def event_source(p, subscribe, opts \\ [])

  def event_source(%Situ.Graph.Handle{} = p, subscribe, opts)
      when is_function(subscribe, 1) do
    opts = Keyword.put_new(opts, :on_same_time, :nudge)
    {own, placed} = Placement.split!(opts, @events, :generator)
    add(p, "EventSource", {Events, [subscribe: subscribe] ++ own}, placed)
  end

  def event_source(other, _arg2, _arg3),
    do: Argument.refuse!(other, :handle, "Situ.event_source(p, fn post -> subscribe(post) end)")

  defp paced(p, name, {initial, next}, opts) do
    {own, placed} = Placement.split!(opts, @paced, :generator)
    {every, count, align} = {own[:every], own[:count], own[:align]}
    check_every!(every, count)
    feed = fn start -> Feed.paced({:sequence, initial, next, count}, start, every, align) end
    keep_open = own[:keep_open] or count == :infinity
    add(p, name, {Source, [feed: feed, keep_open: keep_open]}, placed)
  end

  defp single(p, name, value, keep_open, opts) do
    {[], placed} = Placement.split!(opts, [], :generator)
    feed = fn start -> Feed.paced({:sequence, value, & &1, 1}, start, 1, nil) end
    add(p, name, {Source, [feed: feed, keep_open: keep_open]}, placed)
  end

  defp add(p, name, {module, own}, placed) do
    {type, placed} = Keyword.pop(placed, :type, :any)
    placed = [default_name: name, outputs: [out: type]] ++ placed
    p |> Pipeline.add(module, own ++ placed) |> Situ.Node.output(:out)
  end

  # No more is known of what is read lazily.
  defp at_most(list) when is_list(list) and length(list) < 2, do: length(list)
  defp at_most(%Range{} = range), do: min(Range.size(range), 2)
  defp at_most(_enumerable), do: :infinity

  defp type(%Range{}), do: :integer
  defp type(_enumerable), do: :any

  defp check_every!(every, _count) when every > 0, do: :ok

  # Times must increase, which one message always does.
  defp check_every!(_every, count) when count in [0, 1], do: :ok

  defp check_every!(every, _count) do
    raise ArgumentError,
          "messages are 1 ns or more apart: every: is a whole number above 0, got: #{inspect(every)}"
  end
end
