defmodule Situ.Infer.Detection.Suppression do
  @moduledoc """
  Non-maximum suppression: of overlapping boxes, only the most likely one is kept. Pure.

      iex> box = fn x, score -> %{x: x, y: 0.0, width: 10.0, height: 10.0, class: 0, score: score} end
      iex> kept = Situ.Infer.Detection.Suppression.suppress([box.(0.0, 0.6), box.(1.0, 0.9), box.(20.0, 0.5)], 0.5)
      iex> Enum.map(kept, & &1.x)
      [1.0, 20.0]
  """

  @doc """
  Returns the boxes by score. A box is dropped if it overlaps a better box of its class (or of any class, with
  `any_class: true`) by more than `limit` (intersection over union). At most `most:` boxes are returned.
  """
  @spec suppress([box], float(), keyword()) :: [box] when box: map()
  def suppress(boxes, limit, opts \\ []) do
    any? = Keyword.get(opts, :any_class, false)
    most = Keyword.get(opts, :most, 300)

    boxes
    |> Enum.sort_by(&{-&1.score, &1.class, &1.x, &1.y})
    |> keep_boxes([], 0, limit, any?, most)
  end

  defp keep_boxes([], kept, _n, _limit, _any?, _most), do: Enum.reverse(kept)
  defp keep_boxes(_boxes, kept, most, _limit, _any?, most), do: Enum.reverse(kept)

  defp keep_boxes([best | rest], kept, n, limit, any?, most) do
    rest =
      Enum.reject(
        rest,
        &((any? or &1.class == best.class) and intersection_over_union(&1, best) > limit)
      )

    keep_boxes(rest, [best | kept], n + 1, limit, any?, most)
  end

  @doc "Computes the intersection over union, 0..1."
  @spec intersection_over_union(map(), map()) :: float()
  def intersection_over_union(a, b) do
    w = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    h = min(a.y + a.height, b.y + b.height) - max(a.y, b.y)
    common = if w > 0 and h > 0, do: w * h, else: 0.0
    all = a.width * a.height + b.width * b.height - common
    if all > 0, do: common / all, else: 0.0
  end
end
