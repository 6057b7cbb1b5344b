defmodule Situ.Generator do
  @moduledoc false
  # Sources from functions, values, enumerables, timers and events. `Situ` documents them.

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

  alias Situ.Graph.Placement
  alias Situ.{Argument, Pipeline}
  alias Situ.Generator.{Events, ItemFeed, Source, Timer}

  @spec option_schema(atom()) :: Situ.Options.schema()
  def option_schema(kind) when kind in [:sequence, :repeat], do: @paced
  def option_schema(:return), do: @single
  def option_schema(:from_enumerable), do: @enumerable
  def option_schema(:timer), do: @timer
  def option_schema(:event_source), do: @events

  def sequence(%Situ.Graph.Handle{} = p, initial, next, opts) when is_function(next, 1),
    do: add_paced_source(p, "Sequence", {initial, next}, opts)

  def sequence(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :handle,
        "Situ.sequence(p, 0, &(&1 + 1), every: Situ.Time.ms(20))"
      )

  def repeat(%Situ.Graph.Handle{} = p, value, opts),
    do: add_paced_source(p, "Repeat", {value, & &1}, opts)

  def repeat(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :handle, "Situ.repeat(p, 1, every: Situ.Time.ms(20))")

  def return(%Situ.Graph.Handle{} = p, value, opts) do
    {own, placement} = Placement.split_options!(opts, @single, :generator)
    feed = fn start -> ItemFeed.build_paced({:sequence, value, & &1, 1}, start, 1, nil) end
    add_source(p, "Return", {Source, [feed: feed, keep_open: own[:keep_open]]}, placement)
  end

  def return(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :handle, "Situ.return(p, 1)")

  def from_enumerable(%Situ.Graph.Handle{} = p, enumerable, opts) do
    {own, placement} = Placement.split_options!(opts, @enumerable, :generator)
    if own[:start], do: Pipeline.propose_replay(p, {own[:start], :unbounded})
    placement = Keyword.put_new(placement, :type, item_type(enumerable))

    case own[:every] do
      nil ->
        feed = fn _start -> ItemFeed.build_timed(ItemFeed.to_items(enumerable)) end
        equal = placement[:on_same_time] != :error
        options = [feed: feed, timed: true, equal: equal, keep_open: own[:keep_open]]
        add_source(p, "Enumerable", {Source, options}, placement)

      every ->
        check_every!(every, known_max_count(enumerable))

        feed = fn start ->
          ItemFeed.build_paced(ItemFeed.to_items(enumerable), start, every, own[:align])
        end

        add_source(p, "Enumerable", {Source, [feed: feed, keep_open: own[:keep_open]]}, placement)
    end
  end

  def from_enumerable(other, _arg2, _arg3),
    do:
      Argument.raise_invalid!(
        other,
        :handle,
        "Situ.from_enumerable(p, 1..9, every: Situ.Time.ms(20))"
      )

  def timer(%Situ.Graph.Handle{} = p, opts) do
    {own, placement} = Placement.split_options!(opts, @timer, :generator)
    type = if own[:fun], do: :any, else: :integer
    add_source(p, "Timer", {Timer, own}, Keyword.put_new(placement, :type, type))
  end

  def timer(other, _arg2),
    do: Argument.raise_invalid!(other, :handle, "Situ.timer(p, every: Situ.Time.ms(20))")

  def event_source(%Situ.Graph.Handle{} = p, subscribe, opts)
      when is_function(subscribe, 1) do
    opts = Keyword.put_new(opts, :on_same_time, :nudge)
    {own, placement} = Placement.split_options!(opts, @events, :generator)
    add_source(p, "EventSource", {Events, [subscribe: subscribe] ++ own}, placement)
  end

  def event_source(other, _arg2, _arg3),
    do:
      Argument.raise_invalid!(
        other,
        :handle,
        "Situ.event_source(p, fn post -> subscribe(post) end)"
      )

  defp add_paced_source(p, name, {initial, next}, opts) do
    {own, placement} = Placement.split_options!(opts, @paced, :generator)
    {every, count, align} = {own[:every], own[:count], own[:align]}
    check_every!(every, count)

    feed = fn start ->
      ItemFeed.build_paced({:sequence, initial, next, count}, start, every, align)
    end

    keep_open = own[:keep_open] or count == :infinity
    add_source(p, name, {Source, [feed: feed, keep_open: keep_open]}, placement)
  end

  defp add_source(p, name, {module, own}, placement) do
    {type, placement} = Keyword.pop(placement, :type, :any)
    placement = [default_name: name, outputs: [out: type]] ++ placement
    p |> Pipeline.add(module, own ++ placement) |> Situ.Node.output(:out)
  end

  # The number of items of a lazy enumerable is unknown.
  defp known_max_count(list) when is_list(list) and length(list) < 2, do: length(list)
  defp known_max_count(%Range{} = range), do: min(Range.size(range), 2)
  defp known_max_count(_enumerable), do: :infinity

  defp item_type(%Range{}), do: :integer
  defp item_type([%Situ.Columns{kind: kind} | _]), do: kind
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
