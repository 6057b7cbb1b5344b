defmodule Situ.Metric.ReferenceTest do
  use ExUnit.Case, async: true
  import Situ.Experiment.Test.Reference
  alias Situ.Rect

  alias Situ.Metric.{
    ClassScore,
    DetectionScore,
    IntervalScore,
    Measure,
    RegressionScore,
    SpeakerWordScore,
    Statistics,
    TrackScore,
    WordScore
  }

  @frame 10

  defp rect([x, y, width, height]), do: Rect.new!(x, y, width, height)

  defp segments(labels) do
    %{"" => for({label, i} <- Enum.with_index(labels), do: {i * @frame, (i + 1) * @frame, label})}
  end

  test "classes have the kappa, accuracy and macro F1 of scikit-learn" do
    for c <- read("sklearn")["classes"] do
      span = {0, length(c["truth"]) * @frame}
      counts = ClassScore.count_labels(segments(c["truth"]), segments(c["output"]), span, @frame)
      values = ClassScore.compute_values(counts)
      for name <- ~w(kappa accuracy macro_f1), do: assert(close?(values[name], c[name]))

      for {row, truth} <- Enum.zip(c["confusion"], ~w(a b c)),
          {n, output} <- Enum.zip(row, ~w(a b c)),
          do: assert(Map.get(counts, "#{truth} -> #{output}", 0) == n)
    end
  end

  test "the time that intervals cover has the precision, recall and F1 of frames in scikit-learn" do
    intervals = fn flags ->
      %{"" => for({1, i} <- Enum.with_index(flags), do: {i * @frame, (i + 1) * @frame})}
    end

    for c <- read("sklearn")["frames"] do
      counts =
        IntervalScore.count_matches(intervals.(c["truth"]), intervals.(c["output"]), tolerance: 0)

      values = IntervalScore.compute_values(counts)
      for name <- ~w(precision recall f1), do: assert(close?(values["time_" <> name], c[name]))
    end
  end

  test "intervals are matched as in mir_eval" do
    reference = read("mir_eval")
    tolerance = round(reference["tolerance_s"] * 1.0e9)
    to_ns = &for([a, b] <- &1, do: {round(a * 1.0e9), round(b * 1.0e9)})

    for c <- reference["cases"] do
      {truth, output} = {to_ns.(c["truth"]), to_ns.(c["output"])}
      opts = [tolerance: tolerance, match: :boundaries]
      assert length(IntervalScore.match_intervals(truth, output, opts)) == c["matched"]

      opts = [tolerance: tolerance, match: :onset]

      values =
        IntervalScore.compute_values(
          IntervalScore.count_matches(%{"" => truth}, %{"" => output}, opts)
        )

      for name <- ~w(precision recall f1), do: assert(close?(values[name], c["onset_" <> name]))
    end
  end

  test "numbers have the errors of scikit-learn, also when sessions are merged" do
    for c <- read("sklearn")["regression"] do
      pairs = Enum.zip(c["truth"], c["output"])
      parts = pairs |> Enum.chunk_every(7) |> Enum.map(&RegressionScore.sum_errors(&1, 0))

      for counts <- [
            RegressionScore.sum_errors(pairs, 0),
            Measure.merge_all(RegressionScore, parts)
          ] do
        values = RegressionScore.compute_values(counts)
        for name <- ~w(mae rmse r2), do: assert_in_delta(values[name], c[name], 1.0e-9)
      end
    end
  end

  test "texts have the word error rate of jiwer, also when sessions are merged" do
    reference = read("jiwer")
    counts = for t <- reference["texts"], do: WordScore.count_errors(t["truth"], t["output"])

    for {text, count} <- Enum.zip(reference["texts"], counts),
        do: assert(close?(WordScore.compute_values(count)["wer"], text["wer"]))

    total = WordScore.compute_values(Measure.merge_all(WordScore, counts))["wer"]
    assert close?(total, reference["total"])
  end

  test "who said what has the cpWER and tcpWER of meeteval" do
    utterances =
      &for [who, from, to, text] <- &1, do: {who, round(from * 1.0e9), round(to * 1.0e9), text}

    for c <- read("meeteval")["cases"] do
      {truth, output} = {utterances.(c["truth"]), utterances.(c["output"])}

      for {collar, errors} <- c["tcp_errors"] do
        {seconds, _} = Float.parse(collar)
        counts = SpeakerWordScore.count_errors(truth, output, round(seconds * 1.0e9))

        assert counts == %{
                 "words" => c["words"],
                 "cp_errors" => c["cp_errors"],
                 "tcp_errors" => errors
               }

        assert close?(SpeakerWordScore.compute_values(counts)["cpwer"], c["cpwer"])
      end
    end
  end

  test "tracks have the MOTA, IDF1 and switches of motmetrics" do
    for s <- read("motmetrics")["sequences"] do
      boxes = &Map.new(&1, fn {id, box} -> {id, rect(box)} end)

      counts =
        TrackScore.count_images(for([a, b] <- s["frames"], do: {boxes.(a), boxes.(b)}), 0.5)

      values = TrackScore.compute_values(counts)
      assert counts["missed"] == s["num_misses"]
      assert counts["false"] == s["num_false_positives"]
      assert counts["switches"] == s["num_switches"]
      assert counts["identity"] == s["idtp"]
      assert close?(values["mota"], s["mota"])
      assert close?(values["idf1"], s["idf1"])
    end
  end

  test "boxes have the average precision of COCO" do
    for set <- read("pycocotools")["sets"] do
      images =
        for [truth, output] <- set["images"] do
          {for([box, label] <- truth, do: {rect(box), label}),
           for([box, label, score] <- output, do: {rect(box), label, score})}
        end

      for {overlap, name} <- [{0.5, "map50"}, {0.75, "map75"}] do
        values = DetectionScore.compute_values(DetectionScore.match_boxes(images, overlap))
        assert_in_delta values["map"], set[name], 1.0e-9
      end
    end
  end

  test "paired comparisons have the p-value of an exact permutation test in scipy" do
    mean = &(Enum.sum(&1) / length(&1))

    for c <- read("scipy")["pairs"] do
      result = Statistics.compare_pairs(Enum.zip(c["first"], c["second"]), mean, 1)
      assert close?(result.p, c["p"])
      assert close?(result.difference, c["difference"])

      # Both are simulations, with different random numbers.
      {low, high} = Statistics.bootstrap_interval(c["first"], mean, 1)
      [expected_low, expected_high] = c["bootstrap"]
      assert_in_delta low, expected_low, 0.1
      assert_in_delta high, expected_high, 0.1
    end
  end
end
