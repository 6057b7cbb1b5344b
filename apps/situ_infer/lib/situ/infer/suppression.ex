defmodule Situ.Infer.Suppression do
  @moduledoc false
  # Non-maximum suppression: of overlapping detections, only the best one is kept. Pure.
  alias Situ.Infer.Face
  alias Situ.Rect

  @doc """
  Returns at most `most` boxes by score. A box is dropped if it overlaps a better box of its class by more than `limit`
  (intersection over union).

      iex> box = fn x, score -> %{x: x, y: 0.0, width: 10.0, height: 10.0, class: 0, score: score} end
      iex> best = Situ.Infer.Suppression.suppress_boxes([box.(0.0, 0.6), box.(1.0, 0.9), box.(20.0, 0.5)], 0.5)
      iex> Enum.map(best, & &1.x)
      [1.0, 20.0]
  """
  @spec suppress_boxes([box], float(), pos_integer()) :: [box] when box: map()
  def suppress_boxes(boxes, limit, most \\ 300) do
    boxes
    |> Enum.sort_by(&{-&1.score, &1.class, &1.x, &1.y})
    |> suppress(most, &(&1.class == &2.class and intersection_over_union(&1, &2) > limit))
  end

  @doc "Drops each face that is the same face as an earlier one, see `same_face?/3`."
  @spec suppress_faces([Face.t()], float()) :: [Face.t()]
  def suppress_faces(faces, limit), do: suppress(faces, :infinity, &same_face?(&1, &2, limit))

  # `most` is an integer or :infinity, which no count equals.
  defp suppress(items, most, overlap?) do
    items
    |> Enum.reduce_while({[], 0}, fn item, {best, count} ->
      cond do
        count == most -> {:halt, {best, count}}
        Enum.any?(best, &overlap?.(item, &1)) -> {:cont, {best, count}}
        true -> {:cont, {[item | best], count + 1}}
      end
    end)
    |> elem(0)
    |> Enum.reverse()
  end

  @doc "Computes the intersection over union of two boxes, 0..1."
  @spec intersection_over_union(map(), map()) :: float()
  def intersection_over_union(a, b) do
    w = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    h = min(a.y + a.height, b.y + b.height) - max(a.y, b.y)
    common = if w > 0 and h > 0, do: w * h, else: 0.0
    all = a.width * a.height + b.width * b.height - common
    if all > 0, do: common / all, else: 0.0
  end

  @doc """
  Returns whether two faces overlap by `limit` (intersection over union) or more, or one covers most of the other,
  which is then the same face at another scale.
  """
  @spec same_face?(Face.t(), Face.t(), float()) :: boolean()
  def same_face?(%Face{rect: a}, %Face{rect: b}, limit),
    do: Rect.iou(a, b) >= limit or covered_share(a, b) >= 0.7

  # Returns the share of the smaller rectangle that the other one covers.
  defp covered_share(a, b) do
    smaller = min(Rect.area(a), Rect.area(b))

    case Rect.intersect(a, b) do
      nil -> 0.0
      common when smaller > 0 -> Rect.area(common) / smaller
      _ -> 0.0
    end
  end
end
