defmodule Situ.Metric.TrackScore do
  @moduledoc false
  # Compares tracked boxes with true tracks: MOTA (K. Bernardin, R. Stiefelhagen, 2008) and IDF1 (E. Ristani et al.,
  # 2016).
  @behaviour Situ.Metric.Measure

  alias Situ.Metric.{Assignment, Ratio}
  alias Situ.Rect

  @type tracks :: %{term() => Rect.t()}

  @impl true
  def directions, do: %{"mota" => :higher, "idf1" => :higher, "switches" => :lower}

  @doc """
  Counts misses, false boxes, switches of identity and identity matches of `[{truth, output}]`, one pair of maps from
  track to box for each image. A pair of boxes may match if they overlap by at least `overlap`.

      iex> box = Situ.Rect.new!(0, 0, 10, 10)
      iex> Situ.Metric.TrackScore.count_images([{%{1 => box}, %{7 => box}}, {%{1 => box}, %{8 => box}}], 0.5)
      %{"truth" => 2, "output" => 2, "missed" => 0, "false" => 0, "switches" => 1, "identity" => 1}
  """
  @spec count_images([{tracks(), tracks()}], number()) :: %{String.t() => non_neg_integer()}
  def count_images(images, overlap) do
    start = %{last: %{}, missed: 0, false: 0, switches: 0, together: %{}}
    state = Enum.reduce(images, start, &count_image(&1, &2, overlap))

    %{
      "truth" => Enum.sum(for {truth, _} <- images, do: map_size(truth)),
      "output" => Enum.sum(for {_, output} <- images, do: map_size(output)),
      "missed" => state.missed,
      "false" => state.false,
      "switches" => state.switches,
      "identity" => count_identity(state.together)
    }
  end

  defp count_image({truth, output}, state, overlap) do
    distances = list_distances(truth, output, overlap)
    kept = for {id, other} <- state.last, is_map_key(distances, {id, other}), do: {id, other}
    kept = Enum.uniq_by(kept, &elem(&1, 1))
    pairs = kept ++ pair_remaining(truth, output, distances, kept)

    switches = Enum.count(pairs, fn {id, other} -> Map.get(state.last, id, other) != other end)

    %{
      state
      | last: Map.merge(state.last, Map.new(pairs)),
        missed: state.missed + map_size(truth) - length(pairs),
        false: state.false + map_size(output) - length(pairs),
        switches: state.switches + switches,
        together:
          for({pair, _} <- distances, reduce: state.together) do
            together -> Map.update(together, pair, 1, &(&1 + 1))
          end
    }
  end

  defp list_distances(truth, output, overlap) do
    for {id, box} <- truth,
        {other, rect} <- output,
        iou = Rect.iou(box, rect),
        iou >= overlap,
        into: %{} do
      {{id, other}, 1.0 - iou}
    end
  end

  defp pair_remaining(truth, output, distances, kept) do
    ids = Enum.sort(Map.keys(truth) -- Enum.map(kept, &elem(&1, 0)))
    others = Enum.sort(Map.keys(output) -- Enum.map(kept, &elem(&1, 1)))
    costs = for id <- ids, do: for(other <- others, do: Map.get(distances, {id, other}, :never))
    for {i, j} <- Assignment.pair_rows(costs), do: {Enum.at(ids, i), Enum.at(others, j)}
  end

  # Each true track is paired with one output track, so that they are together in as many images as possible. Surplus
  # pairs without a common image do not change the sum.
  defp count_identity(together) do
    ids = together |> Map.keys() |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort()
    others = together |> Map.keys() |> Enum.map(&elem(&1, 1)) |> Enum.uniq() |> Enum.sort()
    costs = for id <- ids, do: for(other <- others, do: -Map.get(together, {id, other}, 0))

    Enum.sum(
      for {i, j} <- Assignment.pair_rows(costs),
          do: Map.get(together, {Enum.at(ids, i), Enum.at(others, j)}, 0)
    )
  end

  @impl true
  def compute_values(counts) do
    errors = counts["missed"] + counts["false"] + counts["switches"]
    wrong = Ratio.divide(errors, counts["truth"])

    %{
      "mota" => wrong && 1.0 - wrong,
      "idf1" => Ratio.divide(2 * counts["identity"], counts["truth"] + counts["output"]),
      "switches" => counts["switches"]
    }
  end
end
