defmodule Situ.Metric.DetectionScore do
  @moduledoc false
  # Compares boxes in images with the true ones: average precision at an overlap (intersection over union), as COCO
  # defines it: precision at 101 levels of recall, interpolated, and the mean over the labels.
  @behaviour Situ.Metric.Measure

  alias Situ.Metric.Ratio
  alias Situ.Rect

  @type box :: {Rect.t(), label :: String.t()}
  @type detection :: {Rect.t(), label :: String.t(), score :: number()}

  @impl true
  def directions, do: %{"map" => :higher, "recall" => :higher}

  @doc """
  Matches the detections of images with true boxes. The detection with the highest score chooses first.

      iex> box = Situ.Rect.new!(0, 0, 10, 10)
      iex> images = [{[{box, "face"}], [{box, "face", 0.9}, {Situ.Rect.new!(50, 50, 9, 9), "face", 0.8}]}]
      iex> Situ.Metric.DetectionScore.match_boxes(images, 0.5)
      %{"face" => %{"truth" => 1, "scored" => [[0.9, 1], [0.8, 0]]}}
  """
  @spec match_boxes([{[box()], [detection()]}], number()) :: map()
  def match_boxes(images, overlap) do
    for {truth, output} <- images,
        label <- Enum.uniq(for({_, l} <- truth, do: l) ++ for({_, l, _} <- output, do: l)),
        reduce: %{} do
      counts ->
        boxes = for {rect, ^label} <- truth, do: rect
        found = for {rect, ^label, score} <- output, do: {rect, score}
        entry = %{"truth" => length(boxes), "scored" => score_image(boxes, found, overlap)}
        Map.update(counts, label, entry, &merge_entries(&1, entry))
    end
  end

  defp score_image(boxes, found, overlap) do
    {scored, _free} =
      found
      |> Enum.sort_by(fn {_, score} -> -score end)
      |> Enum.map_reduce(boxes, fn {rect, score}, free ->
        case best_box(free, rect, overlap) do
          nil -> {[score, 0], free}
          box -> {[score, 1], List.delete(free, box)}
        end
      end)

    scored
  end

  defp best_box(free, rect, overlap) do
    fitting = Enum.filter(free, &(Rect.iou(&1, rect) >= overlap))
    Enum.max_by(fitting, &Rect.iou(&1, rect), fn -> nil end)
  end

  defp merge_entries(a, b),
    do: %{"truth" => a["truth"] + b["truth"], "scored" => a["scored"] ++ b["scored"]}

  @impl true
  def merge_counts(a, b), do: Map.merge(a, b, fn _, x, y -> merge_entries(x, y) end)

  @impl true
  def compute_values(counts) do
    known = for {_, %{"truth" => n} = entry} <- counts, n > 0, do: entry
    precisions = Enum.map(known, &average_precision/1)

    hits = Enum.sum(for entry <- known, [_, hit] <- entry["scored"], do: hit)
    truth = Enum.sum(for entry <- known, do: entry["truth"])

    %{
      "map" => Ratio.divide(Enum.sum(precisions), length(precisions)),
      "recall" => Ratio.divide(hits, truth)
    }
  end

  defp average_precision(%{"truth" => truth, "scored" => scored}) do
    {points, _} =
      scored
      |> Enum.sort_by(fn [score, _] -> -score end)
      |> Enum.map_reduce({0, 0}, fn [_, hit], {hits, count} ->
        {{(hits + hit) / truth, (hits + hit) / (count + 1)}, {hits + hit, count + 1}}
      end)

    # The precision at a recall is the best precision at this or a higher recall.
    {points, _} =
      points
      |> Enum.reverse()
      |> Enum.map_reduce(0.0, fn {recall, precision}, best ->
        {{recall, max(best, precision)}, max(best, precision)}
      end)

    # COCO's levels are multiples of the number 0.01, which differ from hundredths in the last digit.
    levels = for level <- 0..100, do: min(level * 0.01, 1.0)
    Enum.sum(sample_precision(levels, Enum.reverse(points))) / 101
  end

  defp sample_precision([], _points), do: []
  defp sample_precision(levels, []), do: Enum.map(levels, fn _ -> 0.0 end)

  defp sample_precision([level | rest] = levels, [{recall, precision} | more] = points) do
    if recall >= level,
      do: [precision | sample_precision(rest, points)],
      else: sample_precision(levels, more)
  end
end
