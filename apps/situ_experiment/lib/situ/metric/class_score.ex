defmodule Situ.Metric.ClassScore do
  @moduledoc false
  # Compares labels with the true ones. Time is divided into frames; the label of a frame is the label at its middle.
  @behaviour Situ.Metric.Measure

  alias Situ.Annotation.Agreement
  alias Situ.Metric.Ratio

  @type segments :: %{String.t() => [{Situ.Time.t(), Situ.Time.t(), label :: String.t()}]}

  # Separates the true label from the label of the output in a key of JSON.
  @separator " -> "
  @none "(none)"

  @impl true
  def directions, do: %{"kappa" => :higher, "accuracy" => :higher, "macro_f1" => :higher}

  @doc """
  Counts the frames of a span by their true label and the label of the output, as `%{"truth -> output" => count}`.

      iex> truth = %{"p" => [{0, 20, "a"}]}
      iex> Situ.Metric.ClassScore.count_labels(truth, %{"p" => [{10, 40, "a"}]}, {0, 40}, 10)
      %{"(none) -> a" => 2, "a -> (none)" => 1, "a -> a" => 1}
  """
  @spec count_labels(segments(), segments(), {Situ.Time.t(), Situ.Time.t()}, pos_integer()) ::
          %{String.t() => pos_integer()}
  def count_labels(truth, output, {from, to}, frame) do
    for track <- Enum.uniq(Map.keys(truth) ++ Map.keys(output)), reduce: %{} do
      counts ->
        (truth[track] || [])
        |> list_cuts(output[track] || [], from, to)
        |> Enum.reduce(counts, &count_piece(&1, &2, {from, to, frame}))
    end
  end

  # Between two cuts, the labels of both sides are constant.
  defp list_cuts(truth, output, from, to) do
    cuts =
      for({a, b, _} <- truth ++ output, time <- [a, b], time > from, time < to, do: time) ++
        [from, to]

    cuts = cuts |> Enum.uniq() |> Enum.sort()

    for {a, b} <- Enum.zip(cuts, tl(cuts)),
        do: {a, b, find_label(truth, a), find_label(output, a)}
  end

  defp find_label(segments, time) do
    Enum.find_value(segments, @none, fn {from, to, label} ->
      if time >= from and time < to, do: label
    end)
  end

  defp count_piece({a, b, truth, output}, counts, span) do
    frames = middles_before(b, span) - middles_before(a, span)
    key = truth <> @separator <> output
    if frames > 0, do: Map.update(counts, key, frames, &(&1 + frames)), else: counts
  end

  # The middle of frame k is at from + k * frame + frame / 2; only complete frames count.
  defp middles_before(time, {from, to, frame}) do
    n = div(2 * (time - from) + frame - 1, 2 * frame)
    n |> max(0) |> min(div(to - from, frame))
  end

  @impl true
  def compute_values(counts) do
    confusion = parse_counts(counts)
    {accuracy, kappa} = Agreement.kappa(confusion)
    %{"accuracy" => accuracy, "kappa" => kappa, "macro_f1" => macro_f1(confusion)}
  end

  @doc "Returns the table of counts as `%{{truth, output} => count}`."
  @spec parse_counts(%{String.t() => number()}) :: %{{String.t(), String.t()} => number()}
  def parse_counts(counts) do
    for {key, count} <- counts, count > 0, into: %{} do
      [truth, output] = String.split(key, @separator, parts: 2)
      {{truth, output}, count}
    end
  end

  # The mean of the F1 of all labels that occur in the truth or in the output.
  defp macro_f1(confusion) do
    labels = confusion |> Map.keys() |> Enum.flat_map(&Tuple.to_list/1) |> Enum.uniq()

    scores =
      for label <- labels do
        matched = Map.get(confusion, {label, label}, 0)
        truth = Enum.sum(for {{^label, _}, count} <- confusion, do: count)
        output = Enum.sum(for {{_, ^label}, count} <- confusion, do: count)
        Ratio.f1_scores(matched, output, truth)["f1"]
      end

    Ratio.divide(Enum.sum(scores), length(scores))
  end
end
