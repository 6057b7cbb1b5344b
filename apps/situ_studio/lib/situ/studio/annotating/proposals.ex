defmodule Situ.Studio.Annotating.Proposals do
  @moduledoc """
  Finds intervals in a stream that may become annotations: times during which a boolean is true, a state or text stays
  the same, or a number is at or above a threshold, and intervals that the messages themselves contain. Messages are
  read page by page, so the stream may be of any length.

      iex> alias Situ.Studio.Annotating.Proposals
      iex> messages = for {t, v} <- [{0, 0.1}, {1, 0.7}, {2, 0.9}, {3, 0.2}, {4, 0.6}], do: {t, v}
      iex> messages |> Proposals.runs(:signal, 0.5) |> Enum.map(&{&1.from, &1.to, Float.round(&1.confidence, 2)})
      [{1, 3, 0.8}, {4, 4, 0.6}]
  """
  alias Situ.Error
  alias Situ.Studio.Draw.{Key, Rhythm, Segments}
  alias Situ.Studio.Source
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
  @spec offered?(atom()) :: boolean()
  def offered?(shape), do: shape in [:spans | @runs]

  @doc "Returns all proposals of a stream. Errors: errors of the source, `:no_segments`, `:too_many`."
  @spec of(Source.t(), String.t(), atom(), number()) :: {:ok, [t()]} | {:error, Error.t()}
  def of(source, stream, shape, threshold \\ 0.5) do
    with true <- offered?(shape) or {:error, none(stream)},
         {:ok, %{from: from, to: to}} <- Source.call(source, :extent, []) do
      start = if shape == :spans, do: [], else: new(threshold)
      step = if shape == :spans, do: &spans/2, else: &page(&1, &2, shape)

      case read(source, stream, from, to, start, step) do
        {:ok, spans} when is_list(spans) -> few(spans |> Enum.reverse() |> settled())
        {:ok, state} -> state |> ended(shape, to) |> few()
        error -> error
      end
    end
  end

  defp few(found) when length(found) <= @most, do: {:ok, found}

  defp few(found) do
    {:error,
     Error.new(:too_many, "#{length(found)} proposals are too many to review",
       fix: "choose another threshold, or narrow the times with an expression (f)"
     )}
  end

  defp none(stream) do
    Error.new(:no_segments, "#{stream} has no segments to propose",
      fix: "choose a stream of booleans, states, numbers or intervals"
    )
  end

  # Messages are read page by page because a recording may not fit into memory.
  defp read(source, stream, from, to, state, step) do
    case Source.call(source, :messages, [stream, from, to, @page]) do
      {:ok, messages, :all} ->
        {:ok, step.(messages, state)}

      {:ok, [_ | _] = messages, :more} ->
        next = List.last(messages).originating_time + 1
        read(source, stream, next, to, step.(messages, state), step)

      {:ok, [], :more} ->
        {:ok, state}

      error ->
        error
    end
  end

  # A recognizer's drafts are superseded by its next result, so a draft is dropped unless it is the last message.
  defp spans(messages, found), do: Enum.reduce(messages, found, &[&1 | &2])

  defp settled([%{data: %{final?: false}} | [_ | _] = rest]), do: settled(rest)

  defp settled([message | rest]) do
    sure = confidence(message.data)

    own =
      for {from, to, label, _, lane} <- Spans.of(message.data, message.originating_time),
          do: %{from: from, to: to, lane: lane, label: label, confidence: sure}

    own ++ settled(rest)
  end

  defp settled([]), do: []

  defp confidence(%{} = data) do
    Enum.find_value([:confidence, :score, :probability, "confidence", "score"], fn key ->
      case Map.get(data, key) do
        x when is_number(x) and x >= 0 and x <= 1 -> x / 1
        _ -> nil
      end
    end)
  end

  defp confidence(_), do: nil

  defp new(threshold), do: %{open: %{}, done: [], recent: [], last: nil, threshold: threshold}

  @doc "Returns the runs in ordered `{time, data}` rows; runs that are still open end at the last row."
  @spec runs([{Situ.Time.t(), term()}], atom(), number()) :: [t()]
  def runs(rows, shape, threshold) do
    messages = for {t, data} <- rows, do: %Situ.Message{data: data, originating_time: t}
    messages |> page(new(threshold), shape) |> ended(shape, nil)
  end

  # Gaps end every run, because the value is unknown while expected messages are missing.
  defp page(messages, state, shape) do
    times = Enum.map(messages, & &1.originating_time)
    holes = Rhythm.holes(for t <- state.recent ++ times, do: {t, 1})
    holes = Map.new(holes, fn {from, to} -> {to, from} end)

    state =
      Enum.reduce(messages, state, fn message, state ->
        t = message.originating_time
        now = lanes(message.data, shape, state.threshold)
        state |> closed(now, holes[t] || t, holes[t] != nil) |> opened(now, t)
      end)

    %{state | recent: Enum.take(state.recent ++ times, -@carried)}
  end

  defp closed(state, now, t, all?) do
    {gone, open} =
      Enum.split_with(state.open, fn {lane, run} ->
        all? or not is_map_key(now, lane) or elem(now[lane], 0) != run.label
      end)

    %{state | open: Map.new(open), done: Enum.map(gone, &run(&1, t)) ++ state.done}
  end

  defp opened(state, now, t) do
    open =
      Enum.reduce(now, state.open, fn {lane, {label, x}}, open ->
        run = Map.get(open, lane) || %{from: t, label: label, sum: 0.0, n: 0}
        Map.put(open, lane, if(x, do: %{run | sum: run.sum + x, n: run.n + 1}, else: run))
      end)

    %{state | open: open, last: t}
  end

  defp run({lane, run}, t) do
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
  defp ended(state, shape, to) do
    t = if shape in [:signal, :signals] or to == nil, do: state.last, else: to
    (Enum.map(state.open, &run(&1, t)) ++ state.done) |> Enum.sort_by(&{&1.lane, &1.from})
  end

  # Returns the active lanes as a map from lane to `{label, number}`.
  defp lanes(data, shape, threshold) when is_map(data) and not is_struct(data) do
    for {key, value} <- data, on = on(value, shape, threshold), into: %{}, do: {Key.text(key), on}
  end

  defp lanes(data, shape, threshold) do
    case on(data, shape, threshold) do
      nil -> %{}
      on -> %{"" => on}
    end
  end

  defp on(x, shape, threshold) when is_number(x) and shape in [:signal, :signals],
    do: if(x >= threshold, do: {"", x})

  defp on(true, _, _), do: {"", nil}
  defp on(off, _, _) when off in [nil, false, ""], do: nil

  defp on(state, shape, _) when shape in [:state, :states, :text],
    do: {Segments.label(state), nil}

  defp on(_, _, _), do: nil
end
