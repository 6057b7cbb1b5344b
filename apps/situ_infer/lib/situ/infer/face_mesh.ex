defmodule Situ.Infer.FaceMesh do
  @moduledoc false
  # The 468 points of a face (MediaPipe's face mesh).
  #
  #   * `id`: the id of the face's track
  #   * `rect`: the face's rectangle in the image
  #   * `score`: the network's confidence that this is a face, 0..1
  #   * `points`: x, y and z of the 468 points as 32-bit floats in pixels of `patch`; read them with `point_at/2` or
  #     `points/1`
  #
  # The most important points are 13 and 14, the inner lips in the middle (upper, lower); 78 and
  # 308, the inner corners of the mouth; 33 and 263, the outer corners of the eyes; 1, the tip of
  # the nose; and 152, the chin.
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

  @doc """
  Returns point `i` (0..467) in image pixels.

      iex> point = &for(v <- &1, into: <<>>, do: <<v::float-native-32>>)
      iex> points = for i <- 0..467, into: <<>>, do: point.([i * 1.0, 2.0, 0.0])
      iex> patch = Situ.Infer.Patch.centered_at({96.0, 96.0}, 192.0, 0.0, 192)
      iex> rect = Situ.Rect.new!(0, 0, 1, 1)
      iex> mesh = %Situ.Infer.FaceMesh{id: 0, rect: rect, score: 1.0, points: points, patch: patch}
      iex> Situ.Infer.FaceMesh.point_at(mesh, 13)
      {13.0, 2.0}
      iex> Situ.Infer.FaceMesh.point_distance(mesh, 13, 14)
      1.0
  """
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
