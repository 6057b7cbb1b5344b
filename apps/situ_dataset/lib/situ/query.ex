defmodule Situ.Query do
  @moduledoc """
  Finds the intervals in which an expression (`Situ.Expression`) over the streams of a session is true.

      session = Situ.Dataset.OpenSession.open(session)
      {:ok, found} = Situ.Query.run(session, "vad and latency(vad) > 500ms", least: Situ.Time.ms(200))
      found.intervals
      #=> [{1700000012000000000, 1700000013500000000}, ...]

  Names are streams: plain (`vad`), in backticks (`` `Lobby.Speaking` ``) or with the partition (`` `[Room]:Level`
  ``). A stream has the value of its latest message, and no value before its first message. `latency(S)` is that
  message's latency and `age(S)` is the time since that message (ns). The value of an annotation stream is a map
  from the tracks that have an annotation at that time to its values: `Speech.P1.Speaker == 'A'`, `'P1' in Speech`.

  The expression is evaluated at every message of the named streams, so the result is exact to their times. An
  interval that is still true at the end ends with the last message. Memory use does not grow with the recording, and
  `timeout:` limits the time.
  """

  @options [
    from: [type: :integer, doc: "The first originating time (ns) of the span."],
    to: [type: :integer, doc: "The last originating time (ns) of the span."],
    least: [type: :non_neg_integer, default: 0, doc: "The minimum length of an interval (ns)."],
    join: [
      type: :non_neg_integer,
      default: 0,
      doc: "The maximum gap (ns) between two intervals that are joined."
    ],
    hold: [
      type: :pos_integer,
      doc:
        "Time (ns) for which a stream keeps the value of its last message. Default: until the next message."
    ],
    limit: [type: :pos_integer, default: 100_000, doc: "Maximum number of intervals."],
    timeout: [type: :pos_integer, default: 60_000, doc: "Time limit in milliseconds."]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @options)

  alias Situ.Annotation
  alias Situ.Annotation.Recording
  alias Situ.Dataset.OpenSession
  alias Situ.{Error, Expression, Options, Store}
  alias Situ.Query.Merge

  @type found :: %{intervals: [{Situ.Time.t(), Situ.Time.t()}], truncated?: boolean()}

  @doc """
  Returns the intervals in which `expression` is true. Errors: `:bad_expression`, `:no_stream`, `:ambiguous_stream`,
  `:timeout`, `:constant` (it does not contain a stream).
  """
  @spec run(OpenSession.t(), String.t() | Expression.t(), keyword()) ::
          {:ok, found()} | {:error, Error.t()}
  def run(%OpenSession{} = session, expression, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, expression} <- ensure_parsed(expression),
         {:ok, streams} <- open_streams(session, Expression.names(expression), opts) do
      deadline = System.monotonic_time(:millisecond) + opts[:timeout]
      search_intervals(streams, expression, opts, deadline)
    end
  rescue
    error in Error -> {:error, error}
  catch
    :late ->
      {:error,
       Error.new(:timeout, "the query took longer than #{opts[:timeout] || 60_000} ms",
         fix: "query a shorter span (from:, to:), or allow more time (timeout:)"
       )}
  end

  defp ensure_parsed(%Expression{} = expression), do: {:ok, expression}
  defp ensure_parsed(text), do: Expression.parse(text)

  defp open_streams(_session, [], _opts) do
    {:error,
     Error.new(:constant, "the expression does not contain a stream",
       fix: "use one, such as `Room.Level` (with backticks if the name contains dots)"
     )}
  end

  defp open_streams(session, names, opts) do
    Enum.reduce_while(names, {:ok, []}, fn name, {:ok, streams} ->
      with {:ok, {_, store, stream}} <- OpenSession.fetch_stream(session, name),
           {:ok, info} <- Store.stream_info(store, stream),
           {:ok, events} <- stream_events(store, info, opts) do
        {:cont, {:ok, [{name, events} | streams]}}
      else
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  # `{time, value, latency}` of messages, or of the starts and ends of annotations.
  defp stream_events(store, info, opts) do
    if Recording.annotation_stream?(store, info) do
      with {:ok, annotations} <- Recording.read_annotations(store, info),
           do: {:ok, annotation_edges(annotations)}
    else
      # The message that is current at the beginning of the span may be before it.
      reading = Keyword.take(opts, [:to])

      before =
        case opts[:from] && Store.latest_at(store, info, opts[:from]) do
          {:ok, %{} = message} ->
            [{message.originating_time, message.data, message_latency(message)}]

          _ ->
            []
        end

      reading = if opts[:from], do: [{:from, opts[:from] + 1} | reading], else: reading

      messages =
        store
        |> Store.messages(info, reading)
        |> Stream.map(&{&1.originating_time, &1.data, message_latency(&1)})

      {:ok, Stream.concat(before, messages)}
    end
  end

  defp message_latency(message), do: message.creation_time - message.originating_time

  defp annotation_edges(annotations) do
    begins = for a <- annotations, do: {a.from, 1, a}
    ends = for a <- annotations, do: {a.to, 0, a}

    # At the same time, ends come before starts; a point has no duration and is skipped.
    (begins ++ ends)
    |> Enum.filter(fn {_, _, a} -> a.from < a.to end)
    |> Enum.sort_by(fn {time, kind, a} -> {time, kind, a.track} end)
    |> Enum.map_reduce(%{}, fn
      {time, 1, a}, open -> open |> Map.put(a.track, a.values) |> then(&{{time, &1, 0}, &1})
      {time, 0, a}, open -> open |> Map.delete(a.track) |> then(&{{time, &1, 0}, &1})
    end)
    |> elem(0)
  end

  # Evaluates the expression after all changes at one time were applied.
  defp search_intervals(streams, expression, opts, deadline) do
    state = %{env: %{}, since: %{}, open: nil, found: [], count: 0, last: nil, opts: opts, n: 0}

    state =
      streams
      |> Merge.merge_events(opts[:hold])
      |> Enum.reduce_while(state, fn {time, changes}, state ->
        if rem(state.n, 1_024) == 0 and System.monotonic_time(:millisecond) > deadline,
          do: throw(:late)

        state = apply_changes(%{state | n: state.n + 1}, time, changes, expression)
        if state.count > opts[:limit], do: {:halt, state}, else: {:cont, state}
      end)

    closed = if state.open, do: add_interval(state, {state.open, state.last}), else: state

    intervals =
      closed.found |> Enum.reverse() |> drop_short(opts[:least]) |> Enum.take(opts[:limit])

    {:ok, %{intervals: intervals, truncated?: state.count > opts[:limit]}}
  end

  defp apply_changes(state, time, changes, expression) do
    {env, since} =
      Enum.reduce(changes, {state.env, state.since}, fn
        {name, :expired}, {env, since} ->
          {Map.drop(env, [name, "latency(#{name})"]), Map.delete(since, name)}

        {name, {value, latency}}, {env, since} ->
          env =
            env
            |> Map.put(name, Expression.Operators.to_plain(value))
            |> Map.put("latency(#{name})", latency)

          {env, Map.put(since, name, time)}
      end)

    ages = for {name, at} <- since, into: env, do: {"age(#{name})", time - at}
    state = %{state | env: env, since: since, last: time}
    true? = Expression.eval(expression, ages) == true and within_span?(time, state.opts)

    case {state.open, true?} do
      {nil, true} -> %{state | open: max(time, state.opts[:from] || time)}
      {open, false} when open != nil -> add_interval(%{state | open: nil}, {open, time})
      _ -> state
    end
  end

  # Messages before the span count from its beginning, so only its end is checked here.
  defp within_span?(time, opts), do: opts[:to] == nil or time <= opts[:to]

  defp add_interval(state, {from, to}) do
    case state.found do
      [{before, ended} | rest] when from - ended <= 0 -> %{state | found: [{before, to} | rest]}
      [{before, ended} | rest] -> join_or_append(state, {before, ended}, rest, {from, to})
      [] -> %{state | found: [{from, to}], count: 1}
    end
  end

  defp join_or_append(state, {before, ended}, rest, {from, to}) do
    if from - ended <= state.opts[:join],
      do: %{state | found: [{before, to} | rest]},
      else: %{state | found: [{from, to}, {before, ended} | rest], count: state.count + 1}
  end

  defp drop_short(intervals, least),
    do: Enum.filter(intervals, fn {from, to} -> to - from >= least end)

  @doc "Converts the intervals to annotations of one track, as proposals for `Situ.Annotation.Edit.add_proposals/2`."
  @spec annotations(found(), String.t(), map(), keyword()) :: [Annotation.t()]
  def annotations(%{intervals: intervals}, track, values \\ %{}, more \\ []) do
    for {from, to} <- intervals,
        do: Annotation.new(from, to, track, values, [{:proposed?, true} | more])
  end
end
