defmodule Situ.Space.Cloud do
  @moduledoc """
  Operations on point clouds: downsampling, clipping, planes, normals, clusters. They take and return binaries.

      iex> cloud = Situ.PointCloud.from_points([{0.1, 0.1, 0.1}, {0.3, 0.1, 0.1}, {5.0, 5.0, 5.0}])
      iex> {:ok, fewer} = Situ.Space.Cloud.downsample(cloud, 1.0)
      iex> Situ.PointCloud.point_count(fewer)
      2
  """
  alias Situ.{Box3, Error, Plane, PointCloud, Pose, Quaternion, Vector3}
  alias Situ.Space.NativeCall

  @type result :: {:ok, PointCloud.t()} | {:error, Error.t()}

  @doc """
  Returns one point for every cube with edges of `size` metres: the mean of the points in it. The points are in the
  order in which their cubes first occur. Colours and values are dropped.
  """
  @spec downsample(PointCloud.t(), number()) :: result()
  def downsample(%PointCloud{} = cloud, size) when is_number(size) do
    with {:ok, {points, _counts}} <-
           NativeCall.call_native(:downsample, [cloud.points, size * 1.0]),
         do: PointCloud.new(points)
  end

  @doc """
  Returns at most `most` points of the cloud, evenly spaced by index, in their order and with their colours and values.
  This is meant for drawing, where each point represents its neighbours.

      iex> cloud = Situ.PointCloud.from_points(for x <- 1..6, do: {x * 1.0, 0.0, 0.0})
      iex> {:ok, fewer} = Situ.Space.Cloud.limit_points(cloud, 2)
      iex> Situ.PointCloud.to_points(fewer)
      [{1.0, 0.0, 0.0}, {4.0, 0.0, 0.0}]
  """
  @spec limit_points(PointCloud.t(), pos_integer()) :: result()
  def limit_points(%PointCloud{} = cloud, most) when is_integer(most) and most > 0 do
    with {:ok, points} <- NativeCall.call_native(:thin, [cloud.points, 12, most]),
         {:ok, colors} <- thin_extra(cloud.colors, 3, most),
         {:ok, values} <- thin_extra(cloud.values, 4, most),
         do: PointCloud.new(points, colors, values)
  end

  defp thin_extra(nil, _size, _most), do: {:ok, nil}
  defp thin_extra(bytes, size, most), do: NativeCall.call_native(:thin, [bytes, size, most])

  @doc """
  Returns at most `most` of the points that are in front of all of these planes, and how many there are in total. Points
  are evenly spaced by index, in their order and with their colours and values. A point is in front of the plane
  `{a, b, c, d}` if `ax + by + cz + d >= 0`; six planes bound the view of a camera. Points that are not finite are
  dropped.

      iex> cloud = Situ.PointCloud.from_points(for x <- 0..9, do: {x * 1.0, 0.0, 0.0})
      iex> {:ok, {near, 4}} = Situ.Space.Cloud.clip_to_planes(cloud, [{-1.0, 0.0, 0.0, 3.0}], 2)
      iex> Situ.PointCloud.to_points(near)
      [{0.0, 0.0, 0.0}, {2.0, 0.0, 0.0}]
  """
  @spec clip_to_planes(PointCloud.t(), [{number(), number(), number(), number()}], pos_integer()) ::
          {:ok, {PointCloud.t(), non_neg_integer()}} | {:error, Error.t()}
  def clip_to_planes(%PointCloud{} = cloud, planes, most) when is_integer(most) and most > 0 do
    planes = for {a, b, c, d} <- planes, do: {a * 1.0, b * 1.0, c * 1.0, d * 1.0}

    %{points: points, colors: colors, values: values} = cloud
    arguments = [points, colors || <<>>, values || <<>>, planes, most]

    with {:ok, {points, some_colors, some_values, count}} <-
           NativeCall.call_native(:within, arguments),
         {:ok, found} <- PointCloud.new(points, colors && some_colors, values && some_values),
         do: {:ok, {found, count}}
  end

  @doc "Transforms a cloud from a pose's own frame to the frame in which the pose is given; keeps colours and values."
  @spec transform(PointCloud.t(), Pose.t()) :: result()
  def transform(%PointCloud{} = cloud, %Pose{} = pose) do
    with {:ok, points} <-
           NativeCall.call_native(:transform, [
             cloud.points,
             Quaternion.to_matrix(pose.rotation),
             pose.position
           ]),
         do: PointCloud.new(points, cloud.colors, cloud.values)
  end

  @doc "Returns the points inside a box or on its surface, in their order and with their colours and values."
  @spec clip(PointCloud.t(), Box3.t()) :: result()
  def clip(%PointCloud{} = cloud, %Box3{} = box) do
    with {:ok, local} <-
           if(box.pose, do: transform(cloud, Pose.invert(box.pose)), else: {:ok, cloud}),
         {:ok, {_points, places}} <-
           NativeCall.call_native(:clip, [local.points, box.min, box.max]),
         do:
           PointCloud.new(
             select_rows(cloud.points, places, 12),
             cloud.colors && select_rows(cloud.colors, places, 3),
             cloud.values && select_rows(cloud.values, places, 4)
           )
  end

  defp select_rows(bytes, places, size) do
    for <<place::little-32 <- places>>, into: <<>>, do: binary_part(bytes, place * size, size)
  end

  @plane [
    tolerance: [
      type: :number,
      default: 0.02,
      doc: "The maximum distance of a point from the plane, metres."
    ],
    rounds: [
      type: :pos_integer,
      default: 500,
      doc: "The number of planes through three random points to try."
    ],
    seed: [type: :non_neg_integer, default: 0, doc: "The same seed gives the same plane."]
  ]

  @doc """
  Fits the plane with the most points on it, and returns it with the indices of these points (32-bit little-endian
  numbers, from 0). The normal's z is not negative. Fewer than three points, or points on one line, are an error.

  #{Situ.Options.docs(@plane)}

      iex> points = for x <- 0..4, y <- 0..4, do: {x * 1.0, y * 1.0, 0.5}
      iex> {:ok, plane, on_it} = Situ.Space.Cloud.fit_plane(Situ.PointCloud.from_points(points))
      iex> {plane.normal |> elem(2) |> Float.round(6), Float.round(plane.offset, 6), byte_size(on_it)}
      {1.0, 0.5, 100}
  """
  @spec fit_plane(PointCloud.t(), keyword()) ::
          {:ok, Plane.t(), places :: binary()} | {:error, Error.t()}
  def fit_plane(%PointCloud{} = cloud, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @plane),
         arguments = [cloud.points, opts[:tolerance] * 1.0, opts[:rounds], opts[:seed]],
         {:ok, {normal, offset, places}} <- NativeCall.call_native(:plane, arguments),
         do: {:ok, %Plane{normal: normal, offset: offset}, places}
  end

  @doc """
  Returns two binaries of 32-bit little-endian floats: for every point the unit normal (three floats) of the surface
  through its neighbours within `radius` metres, pointing to the side of `viewpoint`, and the curvature of the surface
  (one float, 0 for flat, at most 1/3). The normal of a point with fewer than two neighbours is zero.
  """
  @spec estimate_normals(PointCloud.t(), number(), Vector3.t()) ::
          {:ok, {normals :: binary(), curvatures :: binary()}} | {:error, Error.t()}
  def estimate_normals(%PointCloud{} = cloud, radius, viewpoint \\ {0.0, 0.0, 0.0})
      when is_number(radius),
      do: NativeCall.call_native(:normals, [cloud.points, radius * 1.0, viewpoint])

  @doc """
  Returns the clusters of at least `least` points, largest first. Each point of a cluster is within `radius` metres of
  another point of it.
  """
  @spec find_clusters(PointCloud.t(), number(), pos_integer()) ::
          {:ok, [PointCloud.t()]} | {:error, Error.t()}
  def find_clusters(%PointCloud{} = cloud, radius, least \\ 1)
      when is_number(radius) and is_integer(least) and least > 0 do
    with {:ok, names} <- NativeCall.call_native(:clusters, [cloud.points, radius * 1.0, least]) do
      places =
        for(<<name::little-32 <- names>>, do: name)
        |> Enum.with_index()
        |> Enum.reject(fn {name, _} -> name == 0xFFFFFFFF end)
        |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))

      {:ok, for({_name, places} <- Enum.sort(places), do: select_points(cloud, places))}
    end
  end

  defp select_points(cloud, places) do
    places = for place <- places, into: <<>>, do: <<place::little-32>>

    %PointCloud{
      points: select_rows(cloud.points, places, 12),
      colors: cloud.colors && select_rows(cloud.colors, places, 3),
      values: cloud.values && select_rows(cloud.values, places, 4)
    }
  end

  @doc """
  Returns the point of the cloud nearest to a ray and its distance from the ray (metres), or `nil` for an empty cloud.
  """
  @spec nearest_to_ray(PointCloud.t(), Situ.Ray3.t()) :: {Vector3.t(), float()} | nil
  def nearest_to_ray(%PointCloud{} = cloud, ray) do
    cloud
    |> PointCloud.to_points()
    |> Enum.map(&{&1, Situ.Ray3.distance_to(ray, &1)})
    |> Enum.min_by(&elem(&1, 1), fn -> nil end)
  end
end
