defmodule Situ.Infer.Face.Suppression do
  @moduledoc false
  # Non-maximum suppression: of faces that overlap, the first one is kept.
  alias Situ.Rect

  @doc "Keeps the faces that do not overlap an earlier kept face by `limit` (intersection over union) or more."
  @spec suppress_overlaps([Situ.Infer.Face.t()], float()) :: [Situ.Infer.Face.t()]
  def suppress_overlaps(faces, limit) do
    faces
    |> Enum.reduce([], fn face, kept ->
      if no_overlap?(face, kept, limit), do: [face | kept], else: kept
    end)
    |> Enum.reverse()
  end

  @doc """
  Returns whether `face` overlaps none of `others`. A face inside another one counts as the same face at another scale.
  """
  @spec no_overlap?(Situ.Infer.Face.t(), [Situ.Infer.Face.t()], float()) :: boolean()
  def no_overlap?(face, others, limit) do
    Enum.all?(others, fn other ->
      Rect.iou(face.rect, other.rect) < limit and covered_share(face.rect, other.rect) < 0.7
    end)
  end

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
