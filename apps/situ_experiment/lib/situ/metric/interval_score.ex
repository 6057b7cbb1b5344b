defmodule Situ.Metric.IntervalScore do
  @moduledoc false
  # Compares intervals of time, such as speech, with the true ones, track by track.
  #
  # Intervals are matched one to one: as many as possible, and among these the pairs with the smallest differences of
  # their boundaries. Independently of the matching, `time_*` compare the time that both cover.
  @behaviour Situ.Metric.Measure

  alias Situ.Metric.{Assignment, Ratio}

  @type intervals :: %{String.t() => [{Situ.Time.t(), Situ.Time.t()}]}

  @impl true
  def directions do
    %{
      "f1" => :higher,
      "precision" => :higher,
      "recall" => :higher,
      "time_f1" => :higher,
      "time_precision" => :higher,
      "time_recall" => :higher,
      "onset_error_s" => :lower,
      "offset_error_s" => :lower
    }
  end

  @doc """
  Returns counts and sums of one session, which can be added up over sessions.

      iex> {truth, output} = {%{"a" => [{0, 10}, {20, 30}]}, %{"a" => [{1, 10}]}}
      iex> counts = Situ.Metric.IntervalScore.count_matches(truth, output, tolerance: 2)
      iex> {counts["truth"], counts["output"], counts["matched"], counts["onset_error_ns"], counts["overlap_ns"]}
      {2, 1, 1, 1, 9}
  """
  @spec count_matches(intervals(), intervals(), keyword()) :: %{String.t() => number()}
  def count_matches(truth, output, opts) do
    tracks = Enum.uniq(Map.keys(truth) ++ Map.keys(output))

    tracks
    |> Enum.map(&count_track(Map.get(truth, &1, []), Map.get(output, &1, []), opts))
    |> Enum.reduce(empty_counts(), &Map.merge(&1, &2, fn _, a, b -> a + b end))
  end

  defp empty_counts, do: count_track([], [], tolerance: 0)

  defp count_track(truth, output, opts) do
    pairs = match_intervals(truth, output, opts)
    {true_time, output_time} = {merge_overlapping(truth), merge_overlapping(output)}

    %{
      "truth" => length(truth),
      "output" => length(output),
      "matched" => length(pairs),
      "onset_error_ns" => Enum.sum(for {{a, _}, {b, _}} <- pairs, do: abs(a - b)),
      "offset_error_ns" => Enum.sum(for {{_, a}, {_, b}} <- pairs, do: abs(a - b)),
      "truth_ns" => total_length(true_time),
      "output_ns" => total_length(output_time),
      "overlap_ns" => total_length(intersect(true_time, output_time))
    }
  end

  @doc """
  Pairs true intervals with output intervals. With `match: :boundaries`, both boundaries of a pair differ by at most
  `tolerance:` (ns); with `match: :onset`, the start does; with `match: :overlap`, the intervals overlap.

      iex> Situ.Metric.IntervalScore.match_intervals([{0, 10}, {8, 18}], [{5, 14}], match: :overlap, tolerance: 0)
      [{{8, 18}, {5, 14}}]
  """
  @spec match_intervals([interval], [interval], keyword()) :: [{interval, interval}]
        when interval: {Situ.Time.t(), Situ.Time.t()}
  def match_intervals(truth, output, opts) do
    rule = opts[:match] || :boundaries
    costs = for a <- truth, do: for(b <- output, do: pair_cost(a, b, rule, opts[:tolerance]))

    for {i, j} <- Assignment.pair_rows(costs), do: {Enum.at(truth, i), Enum.at(output, j)}
  end

  defp pair_cost({a, b}, {c, d}, rule, tolerance) do
    allowed? =
      case rule do
        :boundaries -> abs(a - c) <= tolerance and abs(b - d) <= tolerance
        :onset -> abs(a - c) <= tolerance
        :overlap -> min(b, d) > max(a, c)
      end

    if allowed?, do: abs(a - c) + abs(b - d), else: :never
  end

  @impl true
  def compute_values(counts) do
    scores = Ratio.f1_scores(counts["matched"], counts["output"], counts["truth"])
    time = Ratio.f1_scores(counts["overlap_ns"], counts["output_ns"], counts["truth_ns"])

    scores
    |> Map.merge(Map.new(time, fn {name, value} -> {"time_" <> name, value} end))
    |> Map.merge(%{
      "onset_error_s" => Ratio.divide(counts["onset_error_ns"] / 1.0e9, counts["matched"]),
      "offset_error_s" => Ratio.divide(counts["offset_error_ns"] / 1.0e9, counts["matched"])
    })
  end

  @doc """
  Returns the times at which truth and output differ for longer than `tolerance` ns, as `{kind, track, from, to}`.

      iex> Situ.Metric.IntervalScore.list_differences(%{"a" => [{0, 10}]}, %{"a" => [{1, 4}, {12, 20}]}, 2)
      [{"missed", "a", 4, 10}, {"false", "a", 12, 20}]
  """
  @spec list_differences(intervals(), intervals(), Situ.Time.duration()) ::
          [{String.t(), String.t(), Situ.Time.t(), Situ.Time.t()}]
  def list_differences(truth, output, tolerance) do
    for track <- Enum.uniq(Map.keys(truth) ++ Map.keys(output)),
        {a, b} =
          {truth |> Map.get(track, []) |> merge_overlapping(),
           merge_overlapping(output[track] || [])},
        {kind, rest} <- [{"missed", subtract(a, b)}, {"false", subtract(b, a)}],
        {from, to} <- rest,
        to - from > tolerance do
      {kind, track, from, to}
    end
    |> Enum.sort_by(fn {kind, track, from, _} -> {from, track, kind} end)
  end

  defp merge_overlapping(intervals) do
    intervals
    |> Enum.filter(fn {from, to} -> to > from end)
    |> Enum.sort()
    |> Enum.reduce([], fn
      {from, to}, [{first, last} | rest] when from <= last -> [{first, max(last, to)} | rest]
      interval, merged -> [interval | merged]
    end)
    |> Enum.reverse()
  end

  defp total_length(intervals), do: Enum.sum(for {from, to} <- intervals, do: to - from)

  defp intersect(left, right) do
    for {a, b} <- left, {c, d} <- right, min(b, d) > max(a, c), do: {max(a, c), min(b, d)}
  end

  defp subtract(intervals, removed), do: Enum.reduce(removed, intervals, &cut_out/2)

  defp cut_out({c, d}, intervals) do
    Enum.flat_map(intervals, fn {a, b} ->
      if d <= a or c >= b,
        do: [{a, b}],
        else: Enum.filter([{a, c}, {d, b}], fn {from, to} -> to > from end)
    end)
  end
end
