defmodule Situ.Infer.ActiveSpeaker.Agreement do
  @moduledoc false
  # Scores how well lips follow loudness: Pearson's correlation of opening and loudness over a window, weighted by how
  # clearly the mouth moved. The arithmetic is pure and in a fixed order, so that every run gives bit-identical results.
  alias Situ.Infer.ActiveSpeaker.Moment

  @min_pairs 4
  @tiny 1.0e-9
  @closed 0.3
  @closed_share 0.125
  # A mouth that moves less than this cannot reach the full score.
  @clear_movement 0.03

  @doc "Returns the change in opening that is a clear movement."
  @spec clear_movement() :: float()
  def clear_movement, do: @clear_movement

  @doc "Returns the best-scoring face, its score, and all scores; `{nil, 0.0, %{}}` without faces."
  @spec best_face([Moment.t()]) :: {term(), float(), %{term() => float()}}
  def best_face([]), do: {nil, 0.0, %{}}

  def best_face([newest | _] = window) do
    scores =
      Map.new(newest.mouths, fn {id, _} ->
        {id, window |> movement_pairs(id) |> score_pairs(@min_pairs)}
      end)

    # Comparing ids as well makes the result unique when scores are equal.
    case Enum.sort_by(scores, fn {id, score} -> {-score, id} end) do
      [] -> {nil, 0.0, scores}
      [{id, score} | _] -> {id, score, scores}
    end
  end

  defp movement_pairs(window, id),
    do: for(m <- window, mouth = m.mouths[id], do: {mouth.opening, m.loudness})

  @doc "Scores pairs of opening and loudness; fewer than `least` pairs score 0.0."
  @spec score_pairs([{float(), float()}], pos_integer()) :: float()
  def score_pairs(pairs, least) when length(pairs) < least, do: 0.0

  def score_pairs(pairs, _least) do
    {low, high} = pairs |> Enum.map(&elem(&1, 0)) |> Enum.min_max()
    pearson_correlation(pairs) * min(1.0, (high - low) / @clear_movement)
  end

  @doc """
  Returns whether lips that clearly move contradict the voice: their correlation with it is below `doubt`, and they
  are closed in an eighth of the loud moments. (A low correlation alone proves little, because a mesh measures wide
  openings poorly.)
  """
  @spec contradicts_voice?([Moment.t()], term(), float()) :: boolean()
  def contradicts_voice?(window, id, doubt) do
    pairs = movement_pairs(window, id)

    baseline =
      for(m <- window, mouth = m.mouths[id], do: mouth.baseline) |> Enum.min(fn -> 0.0 end)

    {low, high} = pairs |> Enum.map(&elem(&1, 0)) |> Enum.min_max(fn -> {0.0, 0.0} end)
    low = min(low, baseline)

    high - low > @clear_movement and pearson_correlation(pairs) < doubt and
      closed_share(pairs, low + @closed * (high - low)) >= @closed_share
  end

  defp closed_share(pairs, closed) do
    mean = Enum.sum(Enum.map(pairs, &elem(&1, 1))) / length(pairs)
    loud = for {opening, loudness} <- pairs, loudness >= mean, do: opening
    Enum.count(loud, &(&1 < closed)) / length(loud)
  end

  # Returns 0.0 if one side is constant.
  defp pearson_correlation(pairs) do
    n = length(pairs)
    {sx, sy} = Enum.reduce(pairs, {0.0, 0.0}, fn {x, y}, {sx, sy} -> {sx + x, sy + y} end)
    {mx, my} = {sx / n, sy / n}

    {xx, yy, xy} =
      Enum.reduce(pairs, {0.0, 0.0, 0.0}, fn {x, y}, {xx, yy, xy} ->
        {dx, dy} = {x - mx, y - my}
        {xx + dx * dx, yy + dy * dy, xy + dx * dy}
      end)

    scale = :math.sqrt(xx) * :math.sqrt(yy)
    if scale > @tiny, do: xy / scale, else: 0.0
  end
end
