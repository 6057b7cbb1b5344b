defmodule Situ.Metric.Measurement do
  @moduledoc false
  # Measures one session: reads the truth and the output of a metric, and computes the counts that sessions add up.
  alias Situ.Dataset.OpenSession
  alias Situ.{Error, Message, Metric, Store}

  alias Situ.Metric.{
    ClassScore,
    DetectionScore,
    IntervalScore,
    MeanScore,
    RegressionScore,
    SpeakerWordScore,
    StreamReader,
    TrackScore,
    WordScore
  }

  @most_moments 100

  @doc """
  Measures all metrics. Returns `%{"name" => %{"counts" => map, "moments" => [[kind, track, from, to]]}}`; moments are
  the times at which the output is wrong, if the metric knows them.
  """
  @spec measure_all(keyword(Metric.t() | function()), Metric.measured(), number()) ::
          {:ok, %{String.t() => map()}} | {:error, Error.t()}
  def measure_all(metrics, measured, speed) do
    Error.map_ok(metrics, fn {name, metric} ->
      with {:ok, counts, moments} <- measure_metric(wrap_function(metric), measured, speed),
           do:
             {:ok, {to_string(name), %{"counts" => counts, "moments" => format_moments(moments)}}}
    end)
    |> then(fn result -> with {:ok, list} <- result, do: {:ok, Map.new(list)} end)
  end

  @doc "Returns a metric for a bare function; other metrics are unchanged."
  @spec wrap_function(Metric.t() | function()) :: Metric.t()
  def wrap_function(%Metric{} = metric), do: metric
  def wrap_function(fun) when is_function(fun, 1), do: Metric.function(fun)

  defp format_moments(moments),
    do:
      for(
        {kind, track, from, to} <- Enum.take(moments, @most_moments),
        do: [kind, track, from, to]
      )

  defp measure_metric(%Metric{kind: :function} = metric, measured, _speed) do
    case metric.fun.(measured) do
      %{} = values ->
        {:ok, MeanScore.count_values(Map.new(values, fn {k, v} -> {to_string(k), v} end)), []}

      value when is_number(value) or value == nil ->
        {:ok, MeanScore.count_values(%{"value" => value}), []}

      other ->
        {:error, bad_result_error(other)}
    end
  end

  defp measure_metric(%Metric{kind: :cost}, measured, _speed) do
    {from, to} = measured.span
    seconds = max(to - from, 1) / 1.0e9
    {:ok, MeanScore.count_values(%{"busy_s_per_s" => measured.busy_s / seconds}), []}
  end

  defp measure_metric(%Metric{kind: :latency}, _measured, :max) do
    {:error,
     Error.new(:no_latency, "latency cannot be measured in a replay as fast as possible",
       why:
         "the creation times of messages then do not depend on the time that the pipeline needs",
       fix: "define settings/0 in the experiment: def settings, do: [speed: 1.0]"
     )}
  end

  defp measure_metric(%Metric{kind: :latency} = metric, measured, _speed) do
    names = for info <- Store.streams(measured.output), do: info.name
    stream = metric.options[:stream]

    with {:ok, messages} <-
           Error.map_ok(if(stream, do: [stream], else: names), &read_output(measured, &1)) do
      {:ok,
       messages
       |> Enum.flat_map(fn some -> Enum.map(some, &(Message.latency(&1) / 1.0e9)) end)
       |> latency_values()
       |> MeanScore.count_values(), []}
    end
  end

  defp measure_metric(%Metric{} = metric, measured, _speed) do
    opts = metric.options

    with {:ok, truth} <- OpenSession.messages(measured.session, opts[:truth]),
         {:ok, output} <- read_output(measured, opts[:stream]) do
      {counts, moments} = compare_streams(metric.kind, truth, output, {measured, opts})
      {:ok, counts, moments}
    end
  end

  defp latency_values([]), do: %{"p50_s" => nil, "p95_s" => nil, "max_s" => nil}

  defp latency_values(list) do
    quantile = &Metric.Statistics.quantile(list, &1)
    %{"p50_s" => quantile.(0.5), "p95_s" => quantile.(0.95), "max_s" => Enum.max(list)}
  end

  defp read_output(%{output: output}, stream) do
    if Store.has_stream?(output, stream) do
      {:ok, Store.messages(output, stream)}
    else
      names = Enum.map(Store.streams(output), & &1.name)

      {:error,
       Error.new(:no_stream, "the experiment has no stream #{inspect(stream)}",
         why: "build/3 returns the streams #{Enum.map_join(names, ", ", &inspect/1)}",
         fix: "return it from build/3, or name another one with stream:"
       )}
    end
  end

  defp compare_streams(:intervals, truth, output, {_measured, opts}) do
    {truth, output} = {StreamReader.read_intervals(truth), StreamReader.read_intervals(output)}

    {IntervalScore.count_matches(truth, output, opts),
     IntervalScore.list_differences(truth, output, opts[:tolerance])}
  end

  defp compare_streams(:classes, truth, output, {measured, opts}) do
    {truth, output} = {StreamReader.read_segments(truth), StreamReader.read_segments(output)}
    counts = ClassScore.count_labels(truth, output, measured.span, opts[:frame])

    {counts,
     IntervalScore.list_differences(label_tracks(truth), label_tracks(output), opts[:frame])}
  end

  defp compare_streams(:regression, truth, output, {_measured, opts}) do
    pairs = StreamReader.pair_messages(truth, output, opts[:tolerance])

    numbers =
      for {a, %Message{} = b} <- pairs,
          do: {StreamReader.read_number(a), StreamReader.read_number(b)}

    {RegressionScore.sum_errors(numbers, length(pairs) - length(numbers)), []}
  end

  defp compare_streams(:detections, truth, output, {_measured, opts}) do
    images =
      for {a, b} <- StreamReader.pair_messages(truth, output, opts[:tolerance]) do
        boxes = for {rect, label, _} <- StreamReader.read_boxes(a), do: {rect, label}
        {boxes, StreamReader.read_boxes(b)}
      end

    {DetectionScore.match_boxes(images, opts[:overlap]), []}
  end

  defp compare_streams(:tracks, truth, output, {_measured, opts}) do
    images =
      for {a, b} <- StreamReader.pair_messages(truth, output, opts[:tolerance]),
          do: {StreamReader.read_tracks(a), StreamReader.read_tracks(b)}

    {TrackScore.count_images(images, opts[:overlap]), []}
  end

  defp compare_streams(:speaker_transcript, truth, output, {_measured, opts}) do
    clean = text_cleaner(opts)

    read = fn messages ->
      for {speaker, from, to, text} <- StreamReader.read_utterances(messages),
          do: {speaker, from, to, clean.(text)}
    end

    {SpeakerWordScore.count_errors(read.(truth), read.(output), opts[:collar]), []}
  end

  defp compare_streams(:transcript, truth, output, {_measured, opts}) do
    clean = text_cleaner(opts)
    read = &(&1 |> StreamReader.read_text() |> clean.())
    {WordScore.count_errors(read.(truth), read.(output)), []}
  end

  defp text_cleaner(opts),
    do: if(opts[:normalize], do: &WordScore.normalize_text/1, else: & &1)

  defp label_tracks(segments) do
    for {track, list} <- segments, {from, to, label} <- list, reduce: %{} do
      tracks ->
        Map.update(tracks, String.trim("#{track} #{label}"), [{from, to}], &[{from, to} | &1])
    end
  end

  defp bad_result_error(other) do
    Error.new(:bad_metric, "a metric's function returned #{inspect(other, limit: 5)}",
      fix: "return a number, nil, or a map from names to numbers"
    )
  end
end
