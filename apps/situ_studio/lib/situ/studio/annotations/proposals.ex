defmodule Situ.Studio.Annotations.Proposals do
  @moduledoc false
  # Finds intervals in a stream that may become annotations: times during which a boolean is true,
  # a state or text stays the same, or a number is at or above a threshold, and intervals that the
  # messages themselves contain. Messages are read page by page, so the stream may be of any
  # length.
  alias Situ.Error
  alias Situ.Studio.Draw.{Key, GapDetection, Segments}
  alias Situ.Studio.StreamReader
  alias Situ.Studio.Visualizers.Spans

  @page 50_000
  @most 20_000
  # This many messages of the previous page are kept to estimate the message rate.
  @carried 64

  @type t :: %{
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          lane: String.t(),
          label: String.t(),
          confidence: float() | nil
        }

  @runs [:boolean, :state, :states, :text, :signal, :signals]

  @doc "Returns whether proposals can be derived from a stream of that shape."
  @spec supports_shape?(atom()) :: boolean()
  def supports_shape?(shape), do: shape in [:spans | @runs]

  @doc "Returns all proposals of a stream. Errors: errors of the source, `:no_segments`, `:too_many`."
  @spec collect_proposals(Situ.Recording.t(), String.t(), atom(), number()) ::
          {:ok, [t()]} | {:error, Error.t()}
  def collect_proposals(source, stream, shape, threshold \\ 0.5) do
    with true <- supports_shape?(shape) or {:error, no_segments_error(stream)},
         {:ok, %{from: from, to: to}} <- StreamReader.fetch_extent(source) do
      start = if shape == :spans, do: [], else: new_state(threshold)

      step =
        if shape == :spans, do: &collect_span_messages/2, else: &collect_page_runs(&1, &2, shape)

      case reduce_messages(source, stream, from, to, start, step) do
        {:ok, spans} when is_list(spans) -> check_count(spans |> Enum.reverse() |> final_spans())
        {:ok, state} -> state |> finish_runs(shape, to) |> check_count()
        error -> error
      end
    end
  end

  defp check_count(found) when length(found) <= @most, do: {:ok, found}

  defp check_count(found) do
    {:error,
     Error.new(:too_many, "#{length(found)} proposals are too many to review",
       fix: "choose another threshold, or narrow the times with an expression (f)"
     )}
  end

  defp no_segments_error(stream) do
    Error.new(:no_segments, "#{stream} has no segments to propose",
      fix: "choose a stream of booleans, states, numbers or intervals"
    )
  end

  # Messages are read page by page because a recording may not fit into memory.
  defp reduce_messages(source, stream, from, to, state, step) do
    case StreamReader.read_messages(source, stream, from, to, @page) do
      {:ok, messages, :all} ->
        {:ok, step.(messages, state)}

      {:ok, [_ | _] = messages, :more} ->
        next = List.last(messages).originating_time + 1
        reduce_messages(source, stream, next, to, step.(messages, state), step)

      {:ok, [], :more} ->
        {:ok, state}

      error ->
        error
    end
  end

  # A recognizer's drafts are superseded by its next result, so a draft is dropped unless it is the last message.
  defp collect_span_messages(messages, found), do: Enum.reduce(messages, found, &[&1 | &2])

  defp final_spans([%{data: %{final?: false}} | [_ | _] = rest]), do: final_spans(rest)

  defp final_spans([message | rest]) do
    sure = data_confidence(message.data)

    own =
      for {from, to, label, _, lane} <- Spans.find_spans(message.data, message.originating_time),
          do: %{from: from, to: to, lane: lane, label: label, confidence: sure}

    own ++ final_spans(rest)
  end

  defp final_spans([]), do: []

  defp data_confidence(%{} = data) do
    Enum.find_value([:confidence, :score, :probability, "confidence", "score"], fn key ->
      case Map.get(data, key) do
        x when is_number(x) and x >= 0 and x <= 1 -> x / 1
        _ -> nil
      end
    end)
  end

  defp data_confidence(_), do: nil

  defp new_state(threshold),
    do: %{open: %{}, done: [], recent: [], last: nil, threshold: threshold}

  @doc """
  Returns the runs in ordered `{time, data}` rows; runs that are still open end at the last row.

      iex> alias Situ.Studio.Annotations.Proposals
      iex> messages = for {t, v} <- [{0, 0.1}, {1, 0.7}, {2, 0.9}, {3, 0.2}, {4, 0.6}], do: {t, v}
      iex> messages |> Proposals.find_runs(:signal, 0.5) |> Enum.map(&{&1.from, &1.to, Float.round(&1.confidence, 2)})
      [{1, 3, 0.8}, {4, 4, 0.6}]
  """
  @spec find_runs([{Situ.Time.t(), term()}], atom(), number()) :: [t()]
  def find_runs(rows, shape, threshold) do
    messages = for {t, data} <- rows, do: %Situ.Message{data: data, originating_time: t}
    messages |> collect_page_runs(new_state(threshold), shape) |> finish_runs(shape, nil)
  end

  # Gaps end every run, because the value is unknown while expected messages are missing.
  defp collect_page_runs(messages, state, shape) do
    times = Enum.map(messages, & &1.originating_time)
    holes = GapDetection.find_gaps(for t <- state.recent ++ times, do: {t, 1})
    holes = Map.new(holes, fn {from, to} -> {to, from} end)

    state =
      Enum.reduce(messages, state, fn message, state ->
        t = message.originating_time
        now = active_lanes(message.data, shape, state.threshold)
        state |> close_runs(now, holes[t] || t, holes[t] != nil) |> open_runs(now, t)
      end)

    %{state | recent: Enum.take(state.recent ++ times, -@carried)}
  end

  defp close_runs(state, now, t, all?) do
    {gone, open} =
      Enum.split_with(state.open, fn {lane, run} ->
        all? or not is_map_key(now, lane) or elem(now[lane], 0) != run.label
      end)

    %{state | open: Map.new(open), done: Enum.map(gone, &finish_run(&1, t)) ++ state.done}
  end

  defp open_runs(state, now, t) do
    open =
      Enum.reduce(now, state.open, fn {lane, {label, x}}, open ->
        run = Map.get(open, lane) || %{from: t, label: label, sum: 0.0, n: 0}
        Map.put(open, lane, if(x, do: %{run | sum: run.sum + x, n: run.n + 1}, else: run))
      end)

    %{state | open: open, last: t}
  end

  defp finish_run({lane, run}, t) do
    mean = if run.n > 0, do: run.sum / run.n

    %{
      from: run.from,
      to: max(t, run.from),
      lane: lane,
      label: run.label,
      confidence: mean && mean |> max(0.0) |> min(1.0)
    }
  end

  # A state is valid until the end of the data, but a number only until its last message.
  defp finish_runs(state, shape, to) do
    t = if shape in [:signal, :signals] or to == nil, do: state.last, else: to
    (Enum.map(state.open, &finish_run(&1, t)) ++ state.done) |> Enum.sort_by(&{&1.lane, &1.from})
  end

  # Returns the active lanes as a map from lane to `{label, number}`.
  defp active_lanes(data, shape, threshold) when is_map(data) and not is_struct(data) do
    for {key, value} <- data,
        on = lane_value(value, shape, threshold),
        into: %{},
        do: {Key.key_name(key), on}
  end

  defp active_lanes(data, shape, threshold) do
    case lane_value(data, shape, threshold) do
      nil -> %{}
      on -> %{"" => on}
    end
  end

  defp lane_value(x, shape, threshold) when is_number(x) and shape in [:signal, :signals],
    do: if(x >= threshold, do: {"", x})

  defp lane_value(true, _, _), do: {"", nil}
  defp lane_value(off, _, _) when off in [nil, false, ""], do: nil

  defp lane_value(state, shape, _) when shape in [:state, :states, :text],
    do: {Segments.value_label(state), nil}

  defp lane_value(_, _, _), do: nil
end
