defmodule Situ.Mesh do
  @moduledoc """
  A triangle mesh. Vertices are a binary of 32-bit little-endian floats (x, y, z in metres); each triangle has three
  32-bit little-endian vertex indices.

      iex> {:ok, mesh} = Situ.Mesh.from_lists([{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}], [{0, 1, 2}])
      iex> {Situ.Mesh.vertex_count(mesh), Situ.Mesh.triangle_count(mesh)}
      {3, 1}
      iex> {:error, error} = Situ.Mesh.from_lists([{0.0, 0.0, 0.0}], [{0, 1, 2}])
      iex> error.what
      "a triangle uses vertex 2, but the mesh has 1 vertices"
  """
  @behaviour Situ.Codec

  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{Error, PointCloud, Pose, Ray3, Triangle3, Vector3}

  @enforce_keys [:vertices, :indices]
  defstruct [:vertices, :indices, pose: nil]

  @type t :: %__MODULE__{vertices: binary(), indices: binary(), pose: Pose.t() | nil}

  @doc "Builds a validated mesh without copying. A vertex index that is out of range is an error."
  @spec new(binary(), binary(), Pose.t() | nil) :: {:ok, t()} | {:error, Error.t()}
  def new(vertices, indices, pose \\ nil) when is_binary(vertices) and is_binary(indices) do
    count = div(byte_size(vertices), 12)
    highest = highest_index(indices, -1)

    cond do
      rem(byte_size(vertices), 12) != 0 ->
        {:error, Error.new(:bad_mesh, "the size of the vertices must be a multiple of 12 bytes")}

      rem(byte_size(indices), 12) != 0 ->
        {:error, Error.new(:bad_mesh, "the size of the indices must be a multiple of 12 bytes")}

      highest >= count ->
        {:error,
         Error.new(
           :bad_mesh,
           "a triangle uses vertex #{highest}, but the mesh has #{count} vertices"
         )}

      true ->
        {:ok, %__MODULE__{vertices: vertices, indices: indices, pose: pose}}
    end
  end

  defp highest_index(<<i::little-32, rest::binary>>, most), do: highest_index(rest, max(i, most))
  defp highest_index(_rest, most), do: most

  @doc "Builds a mesh from a list of vertices and a list of triangles."
  @spec from_lists([Vector3.t()], [{non_neg_integer(), non_neg_integer(), non_neg_integer()}]) ::
          {:ok, t()} | {:error, Error.t()}
  def from_lists(vertices, triangles) do
    indices =
      for {a, b, c} <- triangles, into: <<>>, do: <<a::little-32, b::little-32, c::little-32>>

    new(Situ.PointCloud.from_points(vertices).points, indices)
  end

  @doc "Returns the number of vertices."
  @spec vertex_count(t()) :: non_neg_integer()
  def vertex_count(%__MODULE__{vertices: vertices}), do: div(byte_size(vertices), 12)

  @doc "Returns the number of triangles."
  @spec triangle_count(t()) :: non_neg_integer()
  def triangle_count(%__MODULE__{indices: indices}), do: div(byte_size(indices), 12)

  @doc "Lists the corners of every triangle in the outer frame."
  @spec list_triangles(t()) :: [{Vector3.t(), Vector3.t(), Vector3.t()}]
  def list_triangles(%__MODULE__{} = mesh) do
    for <<a::little-32, b::little-32, c::little-32 <- mesh.indices>>,
      do: {vertex_position(mesh, a), vertex_position(mesh, b), vertex_position(mesh, c)}
  end

  defp vertex_position(%{vertices: vertices, pose: pose}, index) do
    <<x::little-float-32, y::little-float-32, z::little-float-32>> =
      binary_part(vertices, index * 12, 12)

    if pose, do: Pose.transform_point(pose, {x, y, z}), else: {x, y, z}
  end

  @doc """
  Returns the first point where a ray hits the mesh, from either side, and the index of the triangle (from 0), or
  `nil` if it misses.

      iex> {:ok, mesh} = Situ.Mesh.from_lists([{1.0, -1.0, -1.0}, {1.0, 1.0, -1.0}, {1.0, 0.0, 1.0}], [{0, 1, 2}])
      iex> {:ok, ray} = Situ.Ray3.new({0.0, 0.0, 0.0}, {1.0, 0.0, 0.0})
      iex> Situ.Mesh.intersect_ray(mesh, ray)
      {{1.0, 0.0, 0.0}, 0}
  """
  @spec intersect_ray(t(), Ray3.t()) :: {Vector3.t(), non_neg_integer()} | nil
  def intersect_ray(%__MODULE__{} = mesh, %Ray3{} = ray) do
    local = if mesh.pose, do: Ray3.transform(ray, Pose.invert(mesh.pose)), else: ray

    found =
      find_nearest(mesh, fn triangle ->
        with far when is_float(far) <- Triangle3.ray_distance(triangle, local), do: {far, far}
      end)

    with {far, number} <- found, do: {Ray3.point_at(ray, far), number}
  end

  @doc "Returns the nearest point of the surface and the index of its triangle, or `nil` if the mesh is empty."
  @spec closest_point(t(), Vector3.t()) :: {Vector3.t(), non_neg_integer()} | nil
  def closest_point(%__MODULE__{pose: pose} = mesh, point) do
    local = if pose, do: Pose.transform_point(Pose.invert(pose), point), else: point

    found =
      find_nearest(mesh, fn triangle ->
        near = Triangle3.closest_point(triangle, local)
        {Vector3.distance(near, local), near}
      end)

    with {near, number} <- found,
         do: {if(pose, do: Pose.transform_point(pose, near), else: near), number}
  end

  # Calls `fun` with each triangle in the local frame; `fun` returns `{distance, result}`. Returns the result with the
  # smallest distance.
  defp find_nearest(mesh, fun), do: search_triangles(mesh.indices, mesh.vertices, fun, 0, nil)

  defp search_triangles(
         <<a::little-32, b::little-32, c::little-32, rest::binary>>,
         vertices,
         fun,
         n,
         best
       ) do
    found =
      with {_, _, _} = a <- read_vertex(vertices, a),
           {_, _, _} = b <- read_vertex(vertices, b),
           {_, _, _} = c <- read_vertex(vertices, c),
           do: fun.({a, b, c})

    search_triangles(rest, vertices, fun, n + 1, keep_nearer(best, found, n))
  end

  defp search_triangles(_done, _vertices, _fun, _n, nil), do: nil
  defp search_triangles(_done, _vertices, _fun, _n, {_, answer, number}), do: {answer, number}

  defp keep_nearer(best, nil, _n), do: best
  defp keep_nearer({least, _, _} = best, {far, _}, _n) when least <= far, do: best
  defp keep_nearer(_best, {far, answer}, n), do: {far, answer, n}

  # Returns a vertex in the local frame, or nil if the index is out of range or a coordinate is not finite.
  defp read_vertex(vertices, index) do
    skipped = index * 12

    case vertices do
      <<_::binary-size(skipped), x::little-float-32, y::little-float-32, z::little-float-32,
        _::binary>> ->
        {x, y, z}

      _ ->
        nil
    end
  end

  @doc "Returns the vertices as a point cloud in the outer frame."
  @spec to_cloud(t()) :: PointCloud.t()
  def to_cloud(%__MODULE__{vertices: vertices, pose: nil}), do: %PointCloud{points: vertices}

  def to_cloud(%__MODULE__{vertices: vertices, pose: pose}),
    do: PointCloud.transform(%PointCloud{points: vertices}, pose)

  @doc "Transforms the mesh from the pose's local frame to the frame in which the pose is given."
  @spec transform(t(), Pose.t()) :: t()
  def transform(%__MODULE__{} = mesh, %Pose{} = pose),
    do: %{mesh | pose: if(mesh.pose, do: Pose.compose(pose, mesh.pose), else: pose)}

  @impl Situ.Codec
  def codec_name, do: "situ.mesh"

  @impl Situ.Codec
  def encode(%__MODULE__{} = mesh) do
    pose = if mesh.pose, do: Pose.encode(mesh.pose), else: <<>>

    [
      <<1, if(mesh.pose, do: 1, else: 0), 0::16, vertex_count(mesh)::little-32,
        triangle_count(mesh)::little-32>>,
      pose,
      mesh.vertices,
      mesh.indices
    ]
  end

  @impl Situ.Codec
  def decode(<<1, 1, 0::16, v::little-32, t::little-32, pose::binary-size(64), rest::binary>>) do
    with {:ok, pose} <- Pose.decode(pose), do: decode_arrays(rest, v, t, pose)
  end

  def decode(<<1, 0, 0::16, v::little-32, t::little-32, rest::binary>>),
    do: decode_arrays(rest, v, t, nil)

  def decode(_bytes), do: {:error, Error.new(:bad_mesh, "not a stored mesh")}

  defp decode_arrays(rest, vertices, triangles, pose) do
    case rest do
      <<v::binary-pinned_size(vertices)-unit(96), i::binary-pinned_size(triangles)-unit(96)>> ->
        new(v, i, pose)

      _ ->
        {:error,
         Error.new(
           :bad_mesh,
           "the stored mesh has #{byte_size(rest)} bytes of data, which does not match its header"
         )}
    end
  end

  defimpl Inspect do
    def inspect(%{vertices: vertices, indices: indices} = mesh, _opts)
        when is_binary(vertices) and is_binary(indices),
        do:
          "#Situ.Mesh<#{Situ.Mesh.vertex_count(mesh)} vertices, #{Situ.Mesh.triangle_count(mesh)} triangles>"

    def inspect(_mesh, _opts), do: "#Situ.Mesh<invalid>"
  end
end
