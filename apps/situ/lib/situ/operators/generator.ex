defmodule Situ.Generator do
  @moduledoc """
  Sources made of functions, values, enumerables, timers and events. All are on `Situ` too: `Situ.range/5` ...

      Situ.range(p, 0, 10, Situ.Time.ms(100))                      # 0, 1 ... 9, a tenth of a second apart
      Situ.sequence(p, 1, &(&1 * 2), Situ.Time.ms(100))            # 1, 2, 4 ... without end
      Situ.from_enumerable(p, File.stream!("level.csv"), interval: Situ.Time.ms(20))
      Situ.from_enumerable(p, [{10, :a}, {25, :b}])                # with times

      iex> replay = [replay: [interval: {0, 100}, speed: :max]]
      iex> Situ.to_list(fn p -> Situ.repeat(p, :tick, 30, align: 10) end, times: true, pipeline: replay)
      [{10, :tick}, {40, :tick}, {70, :tick}, {100, :tick}]

  Times are exact: the pipeline's start, start + interval ..., however long it takes to make them. With `align: time` they are the times congruent to
  it modulo the interval, from the first one at or after the start. Items are made as they are asked for, in real time when their time comes, and
  up to the replay's end.

  | generator | ends |
  |---|---|
  | `range/5`, `sequence/5` and `repeat/4` with `count:`, `from_enumerable/3` | with the last item |
  | the same with `keep_open: true`, `once/3` | never: they give what they have and stay open |
  | `sequence/5` and `repeat/4` without `count:`, `timer/3`, `event_source/4` | never |
  | `return/3` | after its one item |

  A source that never ends does not keep a pipeline running once the finite ones have ended; a replay's end ends all of them.

  ## Options

  #{Situ.Options.docs(count: [type: :non_neg_integer, doc: "How many items (`sequence`, `repeat`)."], align: [type: :time_ns, doc: "See above."], keep_open: [type: :boolean, default: false, doc: "Stay open after the last item."], interval: [type: :pos_integer, doc: "ns between items (`from_enumerable`); without it items are `{time, value}` or messages."], start: [type: :time_ns, doc: "Proposes a replay from this time on (`from_enumerable` with times)."], on_same_time: [type: {:in, [:error, :drop, :nudge]}, doc: "Two messages of one time: an error (default), the later one dropped, or 1 ns on (default of `event_source`)."], type: [type: :any, doc: "Type of the stream."], name: [type: :string, doc: "Name of the node."])}
  """

  alias Situ.{Pipeline, Stream}
  alias Situ.Generator.{Events, Feed, Source, Timer}

  @type interval :: Situ.Time.duration()

  @doc "`initial`, `next.(initial)`, ...: `interval` ns apart. Without `count:` it never ends."
  @spec sequence(Pipeline.t(), value, (value -> value), interval(), keyword()) :: Stream.t()
        when value: term()
  def sequence(%Situ.Graph.Handle{} = p, initial, next, interval, opts \\ [])
      when is_function(next, 1),
      do: paced(p, "Sequence", {initial, next}, interval, opts)

  @doc "The integers from `start` on, `count` of them."
  @spec range(Pipeline.t(), integer(), non_neg_integer(), interval(), keyword()) :: Stream.t()
  def range(%Situ.Graph.Handle{} = p, start, count, interval, opts \\ [])
      when is_integer(start) do
    opts = [count: count, type: :integer] |> Keyword.merge(opts)
    paced(p, "Range", {start, &(&1 + 1)}, interval, opts)
  end

  @doc "The same value again and again. Without `count:` it never ends."
  @spec repeat(Pipeline.t(), term(), interval(), keyword()) :: Stream.t()
  def repeat(%Situ.Graph.Handle{} = p, value, interval, opts \\ []),
    do: paced(p, "Repeat", {value, & &1}, interval, opts)

  @doc "One value at the pipeline's start, and that was all."
  @spec return(Pipeline.t(), term(), keyword()) :: Stream.t()
  def return(%Situ.Graph.Handle{} = p, value, opts \\ []),
    do: paced(p, "Return", {value, & &1}, 1, [count: 1] ++ opts)

  @doc "One value at the pipeline's start; the stream stays open."
  @spec once(Pipeline.t(), term(), keyword()) :: Stream.t()
  def once(%Situ.Graph.Handle{} = p, value, opts \\ []),
    do: paced(p, "Once", {value, & &1}, 1, [count: 1, keep_open: true] ++ opts)

  @doc """
  The items of any enumerable: with `interval:` (and `align:`) values that far apart, else `{time, value}` pairs or messages,
  whose times must strictly increase. Read lazily, so endless and costly enumerables are fine.

  Items before the replay's start, asked for or proposed, are passed over.
  """
  @spec from_enumerable(Pipeline.t(), Enumerable.t(), keyword()) :: Stream.t()
  def from_enumerable(%Situ.Graph.Handle{} = p, enumerable, opts \\ []) do
    opts =
      Situ.Options.validate!(
        opts,
        [interval: [type: :integer], start: [type: :time_ns]] ++ schema()
      )

    if opts[:start], do: Pipeline.propose_replay(p, {opts[:start], :unbounded})

    case opts[:interval] do
      nil ->
        feed = fn _start -> Feed.timed(Feed.items(enumerable)) end
        equal = Keyword.get(opts, :on_same_time, :error) != :error
        source(p, "Enumerable", feed, [timed: true, equal: equal], opts)

      interval ->
        check_interval!(interval, :infinity)

        feed = fn start -> Feed.paced(Feed.items(enumerable), start, interval, opts[:align]) end
        source(p, "Enumerable", feed, [], opts)
    end
  end

  @doc """
  A message whenever `interval` ns of the clock have passed, stamped with the clock; its data is the time since the start (ns), or
  `fun.(now, elapsed)` of the option `fun:`. Ticks that were missed are not made up for. Not reproducible: use `repeat/4`
  where exact times matter more than the clock.
  """
  @spec timer(Pipeline.t(), interval(), keyword()) :: Stream.t()
  def timer(%Situ.Graph.Handle{} = p, interval, opts \\ []) do
    opts = Situ.Options.validate!(opts, [fun: [type: {:fun, 2}]] ++ common())
    options = [interval: interval] ++ Keyword.take(opts, [:fun])
    type = if opts[:fun], do: :any, else: :integer
    add(p, "Timer", Timer, options, Keyword.put_new(opts, :type, type))
  end

  @doc """
  What other processes post. When the pipeline starts `subscribe.(post)` is called; whoever calls `post.(data)`, from any process, makes a
  message, stamped with the clock. `unsubscribe.(result_of_subscribe)` is called at the end.
  """
  @spec event_source(Pipeline.t(), ((term() -> :ok) -> handle), (handle -> any()), keyword()) ::
          Stream.t()
        when handle: term()
  def event_source(
        %Situ.Graph.Handle{} = p,
        subscribe,
        unsubscribe \\ fn _ -> :ok end,
        opts \\ []
      ) do
    opts = [on_same_time: :nudge] |> Keyword.merge(opts) |> Situ.Options.validate!(common())
    options = [subscribe: subscribe, unsubscribe: unsubscribe]
    add(p, "EventSource", Events, options, opts)
  end

  defp paced(p, name, {initial, next}, interval, opts) do
    opts = Situ.Options.validate!(opts, [count: [type: :any, default: :infinity]] ++ schema())
    count = check_count!(opts[:count])
    check_interval!(interval, count)
    keep_open = opts[:keep_open] or count == :infinity
    items = {:sequence, initial, next, count}
    feed = fn start -> Feed.paced(items, start, interval, opts[:align]) end
    opts = Keyword.put(opts, :keep_open, keep_open)
    source(p, name, feed, [], opts)
  end

  defp source(p, name, feed, timed, opts) do
    options = [feed: feed, keep_open: opts[:keep_open]] ++ timed
    add(p, name, Source, options, opts)
  end

  defp add(p, name, module, options, opts) do
    common =
      [default_name: name, outputs: [out: opts[:type] || :any]] ++
        Keyword.take(opts, [:name, :on_error, :on_same_time])

    p |> Pipeline.add(module, options, common) |> Situ.Node.output(:out)
  end

  defp schema do
    [align: [type: :time_ns], keep_open: [type: :boolean, default: false]] ++ common()
  end

  defp common do
    [
      name: [type: :string],
      type: [type: :any],
      on_error: [type: {:in, [:stop, :skip, :restart]}],
      on_same_time: [type: {:in, [:error, :drop, :nudge]}]
    ]
  end

  defp check_count!(count) when (is_integer(count) and count >= 0) or count == :infinity,
    do: count

  defp check_count!(count) do
    raise ArgumentError, "count: is an integer of 0 or more, got: #{inspect(count)}"
  end

  defp check_interval!(interval, _count) when is_integer(interval) and interval > 0, do: :ok

  # Times must increase, which one message always does.
  defp check_interval!(interval, count) when is_integer(interval) and count in [0, 1], do: :ok

  defp check_interval!(interval, _count) do
    raise ArgumentError,
          "messages are 1 ns or more apart: the interval is a whole number above 0, got: #{inspect(interval)}"
  end
end
