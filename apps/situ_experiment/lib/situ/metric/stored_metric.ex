defmodule Situ.Metric.StoredMetric do
  @moduledoc false
  # Metrics as JSON. A report reads them from the files of a run, without the code of the experiment. Pure.
  alias Situ.Metric

  alias Situ.Metric.{
    ClassScore,
    DetectionScore,
    IntervalScore,
    MeanScore,
    RegressionScore,
    SpeakerWordScore,
    TrackScore,
    WordScore
  }

  @scores Map.new(
            [
              ClassScore,
              DetectionScore,
              IntervalScore,
              MeanScore,
              RegressionScore,
              SpeakerWordScore,
              TrackScore,
              WordScore
            ],
            &{&1 |> Module.split() |> List.last(), &1}
          )

  @doc "Returns the JSON object of a metric with its name."
  @spec to_json(atom(), Metric.t()) :: map()
  def to_json(name, metric) do
    better = Map.put_new(metric.better, metric.main, Metric.direction(metric, metric.main))

    %{
      "name" => to_string(name),
      "score" => metric.score |> Module.split() |> List.last(),
      "main" => metric.main,
      "better" => Map.new(better, fn {value, direction} -> {value, to_string(direction)} end)
    }
    |> Map.merge(describe_streams(metric))
  end

  # The streams that a metric compares. The studio shows where two sets differ in them.
  defp describe_streams(%Metric{kind: kind, options: options}) do
    case {options[:truth], options[:stream]} do
      {truth, stream} when is_binary(truth) and is_binary(stream) ->
        %{"kind" => to_string(kind), "truth" => truth, "stream" => stream}

      # Reports name the machine of such values.
      _ when kind in [:cost, :latency] ->
        %{"kind" => to_string(kind)}

      _ ->
        %{}
    end
  end

  @doc """
  Returns the metric of a JSON object; it can summarize measurements, but not measure.

      iex> json = Situ.Metric.StoredMetric.to_json(:words, Situ.Metric.transcript(truth: "Words.Truth"))
      iex> metric = Situ.Metric.StoredMetric.from_json(json)
      iex> {metric.main, Situ.Metric.direction(metric, "wer")}
      {"wer", :lower}
  """
  @spec from_json(map()) :: Metric.t()
  def from_json(json) do
    better = Map.new(json["better"], fn {value, text} -> {value, parse_direction(text)} end)
    score = Map.get(@scores, json["score"], MeanScore)
    %Metric{kind: :stored, score: score, main: json["main"], better: better}
  end

  defp parse_direction("lower"), do: :lower
  defp parse_direction(_), do: :higher
end
