defmodule Situ.Infer.ActiveSpeaker.Agreement do
  @moduledoc false
  # How well lips follow loudness: Pearson's correlation of opening and loudness over some moments, times how clearly
  # the mouth moved at all. Pure arithmetic in a fixed order, so that results are equal to the last bit on every run.
  alias Situ.Infer.ActiveSpeaker.Moment

  @min_pairs 4
  @tiny 1.0e-9
  @closed 0.3
  @closed_share 0.125

  @doc "The face that agrees best, its score, and the scores of all; `{nil, 0.0, %{}}` without faces."
  @spec best([Moment.t()], float()) :: {term(), float(), %{term() => float()}}
  def best([], _clear), do: {nil, 0.0, %{}}

  def best([newest | _] = window, clear) do
    scores = Map.new(newest.mouths, fn {id, _} -> {id, score(window, id, clear)} end)

    # Ids are compared too, so that equal scores have one answer.
    case Enum.sort_by(scores, fn {id, score} -> {-score, id} end) do
      [] -> {nil, 0.0, scores}
      [{id, score} | _] -> {id, score, scores}
    end
  end

  @spec score([Moment.t()], term(), float()) :: float()
  def score(window, id, clear) do
    pairs = for m <- window, mouth = m.mouths[id], do: {mouth.opening, m.loudness}

    if length(pairs) < @min_pairs do
      0.0
    else
      {low, high} = pairs |> Enum.map(&elem(&1, 0)) |> Enum.min_max()
      correlation(pairs) * min(1.0, (high - low) / clear)
    end
  end

  @doc """
  Whether lips that clearly move contradict the voice: they agree less than `doubt` with it, and in an eighth of the
  loud moments they are closed. (A mesh says little about how wide a wide mouth is, so that agreement alone is no sign.)
  """
  @spec contradicts?([Moment.t()], term(), float(), float()) :: boolean()
  def contradicts?(window, id, clear, doubt) do
    pairs = for m <- window, mouth = m.mouths[id], do: {mouth.opening, m.loudness}

    baseline =
      for(m <- window, mouth = m.mouths[id], do: mouth.baseline) |> Enum.min(fn -> 0.0 end)

    {low, high} = pairs |> Enum.map(&elem(&1, 0)) |> Enum.min_max(fn -> {0.0, 0.0} end)
    low = min(low, baseline)

    high - low > clear and correlation(pairs) < doubt and
      closed_share(pairs, low + @closed * (high - low)) >= @closed_share
  end

  defp closed_share(pairs, closed) do
    mean = Enum.sum(Enum.map(pairs, &elem(&1, 1))) / length(pairs)
    loud = for {opening, loudness} <- pairs, loudness >= mean, do: opening
    Enum.count(loud, &(&1 < closed)) / length(loud)
  end

  @doc "Pearson's correlation, 0.0 where one side does not change."
  @spec correlation([{float(), float()}]) :: float()
  def correlation(pairs) do
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
