defmodule Situ.Infer.FaceMesh do
  @moduledoc """
  The 468 points of a face (MediaPipe's face mesh), as `Situ.Infer.FaceLandmarks` finds them.

    * `id`: the id of the face's track
    * `rect`: the face's rectangle in the image
    * `score`: the network's confidence that this is a face, 0..1
    * `points`, `patch`: the points in the network's own pixels; `point_at/2` and `points/1` return image pixels

  The most important points are 13 and 14, the inner lips in the middle (upper, lower); 78 and 308, the inner corners of
  the mouth; 33 and 263, the outer corners of the eyes; 1, the tip of the nose; and 152, the chin.
  """
  alias Situ.Infer.Patch

  @enforce_keys [:rect, :score, :points, :patch]
  defstruct [:id, :rect, :score, :points, :patch]

  @type t :: %__MODULE__{
          id: term(),
          rect: Situ.Rect.t(),
          score: float(),
          points: binary(),
          patch: Patch.t()
        }

  @doc "Returns point `i` (0..467) in image pixels."
  @spec point_at(t(), 0..467) :: Patch.point()
  def point_at(%__MODULE__{} = mesh, i),
    do: Patch.to_image_point(mesh.patch, patch_point(mesh, i))

  @doc "Returns all points in image pixels."
  @spec points(t()) :: [Patch.point()]
  def points(%__MODULE__{} = mesh) do
    for <<x::float-native-32, y::float-native-32, _z::32 <- mesh.points>>,
      do: Patch.to_image_point(mesh.patch, {x, y})
  end

  @doc "Computes the distance between two points in pixels of the patch, for ratios that do not depend on the image."
  @spec point_distance(t(), 0..467, 0..467) :: float()
  def point_distance(%__MODULE__{} = mesh, i, j) do
    {x0, y0} = patch_point(mesh, i)
    {x1, y1} = patch_point(mesh, j)
    :math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
  end

  defp patch_point(%__MODULE__{points: points}, i) when i in 0..467 do
    <<x::float-native-32, y::float-native-32, _z::binary-4>> = binary_part(points, i * 12, 12)
    {x, y}
  end
end
