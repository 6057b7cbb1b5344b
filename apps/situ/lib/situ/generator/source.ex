defmodule Situ.Generator.Source do
  @moduledoc false
  # The pull source of the generators. It emits items on demand, up to the replay's end.
  use Situ.Component,
    share_process: true,
    inputs: [],
    outputs: [out: :any],
    options: [
      feed: [type: {:fun, 1}, required: true, doc: "Builds the feed from the start time."],
      timed: [type: :boolean, default: false, doc: "Skips times before the replay."],
      equal: [type: :boolean, default: false, doc: "Leaves equal times to `on_same_time:`."],
      keep_open: [type: :boolean, default: false]
    ]

  alias Situ.Columns
  alias Situ.Generator.ItemFeed

  # phase: :open, :done (no more items), or an error to raise after the preceding items have been emitted.
  defstruct [
    :make,
    :feed,
    :timed,
    :equal,
    :from,
    :keep_open,
    :ahead,
    :last,
    :started,
    phase: :open,
    final: nil,
    taken: 0
  ]

  @impl true
  def init(opts) do
    {:ok,
     %__MODULE__{
       make: opts[:feed],
       timed: opts[:timed],
       equal: opts[:equal],
       keep_open: opts[:keep_open]
     }}
  end

  @impl true
  def handle_start(context, state) do
    open? = state.keep_open and context.replay_end == :infinity
    feed = state.make.(context.start_time)
    from = if state.timed and is_integer(context.replay_start), do: context.replay_start
    state = %{state | feed: feed, from: from, started: context.start_time, keep_open: open?}
    {if(open?, do: [{:complete, :infinity}], else: []), state}
  end

  @impl true
  def handle_demand(_n, _context, %{phase: :done} = state), do: {[], state}
  def handle_demand(_n, _context, %{phase: %Situ.Error{} = error}), do: raise(error)

  def handle_demand(n, context, state) do
    # An atom sorts after every time, so without an end all items are included.
    till = min(context.replay_end, state.final || :infinity)
    produce_items(n, till, state, [])
  end

  @impl true
  def handle_stop(_final, _context, %{phase: phase} = state) when phase != :open, do: {[], state}

  # Values that were requested but not produced yet are produced on demand, up to and including the final time.
  def handle_stop(final, _context, state) do
    if state.last != nil and state.last >= final,
      do: {[], %{state | phase: :done, final: final}},
      else: {[:stopping], %{state | final: final}}
  end

  # Most feeds contain functions and cannot be saved, so the feed is rebuilt and the same number of items is skipped.
  @impl true
  def snapshot(state),
    do: {:ok, Map.take(state, [:taken, :last, :started, :from, :phase, :final, :keep_open])}

  @impl true
  def restore(data, fresh) do
    ItemFeed.close(fresh.feed)
    feed = skip_items(fresh.make.(data.started), data.taken)
    {:ok, fresh |> struct!(data) |> struct!(feed: feed, ahead: nil)}
  end

  defp skip_items(feed, 0), do: feed

  defp skip_items(feed, n) do
    case ItemFeed.next_item(feed) do
      {_time, _value, feed} -> skip_items(feed, n - 1)
      :done -> feed
    end
  end

  @impl true
  def terminate(_reason, %{feed: nil}), do: :ok
  def terminate(_reason, state), do: ItemFeed.close(state.feed)

  # Items at regular times, and numbers in columns, are emitted together.
  defp produce_items(n, till, %{ahead: nil} = state, actions) when n > 0 do
    {found, taken, feed} = ItemFeed.take_together(state.feed, n, {state.from, till})
    taken = state.taken + taken

    case found do
      nil ->
        emit_items(n, till, state, {nil, feed, state.last, taken}, actions)

      {times, data} ->
        reached = {nil, feed, List.last(times), taken}
        emit_items(n - length(times), till, state, reached, [{:out, times, data}])

      %Columns{} = columns ->
        state = put_progress(state, {nil, feed, Columns.last_time(columns), taken})
        actions = [{:out, Columns.drop_envelopes(columns)} | actions]
        produce_items(n - columns.count, till, state, actions)
    end
  end

  defp produce_items(n, till, state, actions),
    do: emit_items(n, till, state, {state.ahead, state.feed, state.last, state.taken}, actions)

  # The progress is written to the state once per demand.
  # If the feed is known to have ended, the end is emitted together with the last item.
  defp emit_items(0, till, state, {nil, feed, _last, _taken} = reached, actions) do
    if ItemFeed.known_ended?(feed, till),
      do: emit_items(1, till, state, reached, actions),
      else: {:lists.reverse(actions), put_progress(state, reached)}
  end

  defp emit_items(0, _till, state, reached, actions),
    do: {:lists.reverse(actions), put_progress(state, reached)}

  defp emit_items(n, till, %{from: from} = state, {ahead, feed, last, taken} = reached, actions) do
    case ahead || ItemFeed.next_item(feed) do
      :done ->
        finish_feed(put_progress(state, reached), actions)

      {time, _value, _feed} = item when time > till ->
        finish_with_ahead(item, put_progress(state, reached), actions)

      {time, _value, feed} when from != nil and time < from ->
        emit_items(n, till, state, {nil, feed, last, taken + 1}, actions)

      {time, _value, _feed}
      when last != nil and (time < last or (time == last and not state.equal)) ->
        fail_not_increasing(time, put_progress(state, reached), actions)

      {time, value, feed} ->
        emit_items(n - 1, till, state, {nil, feed, time, taken + 1}, [
          {:out, time, value} | actions
        ])
    end
  end

  defp put_progress(state, {ahead, feed, last, taken}),
    do: %{state | ahead: ahead, feed: feed, last: last, taken: taken}

  # The next item is after the end. A stop may move the end, but only to an earlier time.
  defp finish_with_ahead(item, state, actions), do: finish_feed(%{state | ahead: item}, actions)

  defp finish_feed(%{final: final} = state, actions) when final != nil,
    do: {:lists.reverse(actions, [:stopped]), %{state | phase: :done}}

  defp finish_feed(%{keep_open: true} = state, actions),
    do: {:lists.reverse(actions), %{state | phase: :done}}

  # The time of the last item may have been nudged, and only the output knows the result.
  defp finish_feed(%{equal: true, last: last} = state, actions) when last != nil,
    do: {:lists.reverse(actions, [{:close, :out}]), %{state | phase: :done}}

  # Closing also marks the output as complete, so that waiting operators can decide immediately.
  defp finish_feed(state, actions) do
    {:lists.reverse(actions, [{:close, :out, state.last || state.started}]),
     %{state | phase: :done}}
  end

  defp fail_not_increasing(time, state, actions) do
    error =
      Situ.Error.new(
        :time_not_increasing,
        "the item at #{time} ns follows an item at #{state.last} ns",
        why: "originating times of a stream must strictly increase",
        fix:
          "sort the items (equal times: on_same_time:), or reorder late items with Situ.reorder/3",
        meta: %{time: time, last_time: state.last}
      )

    if actions == [], do: raise(error), else: {:lists.reverse(actions), %{state | phase: error}}
  end
end
