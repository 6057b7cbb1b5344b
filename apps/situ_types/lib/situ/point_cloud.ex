defmodule Situ.PointCloud do
  @moduledoc """
  A point cloud: one binary with three 32-bit little-endian floats per point (x, y, z in metres). Optional binaries
  hold a colour (three bytes: red, green, blue) and a value (a 32-bit little-endian float, for example laser intensity
  or confidence) per point.

      iex> cloud = Situ.PointCloud.from_points([{0.0, 0.0, 0.0}, {2.0, 4.0, 6.0}])
      iex> {Situ.PointCloud.point_count(cloud), Situ.PointCloud.bounding_box(cloud).max}
      {2, {2.0, 4.0, 6.0}}
      iex> Situ.PointCloud.centroid(cloud)
      {1.0, 2.0, 3.0}
  """
  @behaviour Situ.Codec

  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{Box3, Error, Pose, Vector3}

  @enforce_keys [:points]
  defstruct [:points, colors: nil, values: nil]

  @type t :: %__MODULE__{points: binary(), colors: binary() | nil, values: binary() | nil}

  @doc "Builds a validated cloud without copying. Functions that use a cloud reject coordinates that are not finite."
  @spec new(binary(), binary() | nil, binary() | nil) :: {:ok, t()} | {:error, Error.t()}
  def new(points, colors \\ nil, values \\ nil) when is_binary(points) do
    cond do
      rem(byte_size(points), 12) != 0 ->
        {:error,
         Error.new(
           :bad_cloud,
           "#{byte_size(points)} bytes are not a whole number of points of 12 bytes"
         )}

      colors != nil and byte_size(colors) * 4 != byte_size(points) ->
        {:error,
         Error.new(
           :bad_cloud,
           "#{div(byte_size(points), 12)} points have #{byte_size(colors)} bytes of colour",
           fix: "give three bytes for each point"
         )}

      values != nil and byte_size(values) * 3 != byte_size(points) ->
        {:error,
         Error.new(
           :bad_cloud,
           "#{div(byte_size(points), 12)} points have #{byte_size(values)} bytes of values",
           fix: "give a 32-bit float for each point"
         )}

      true ->
        {:ok, %__MODULE__{points: points, colors: colors, values: values}}
    end
  end

  @doc "Builds a cloud from a list of points."
  @spec from_points([Vector3.t()]) :: t()
  def from_points(points) do
    %__MODULE__{
      points:
        for(
          {x, y, z} <- points,
          into: <<>>,
          do: <<x::little-float-32, y::little-float-32, z::little-float-32>>
        )
    }
  end

  @doc "Returns the points as a list without points whose coordinates are not finite."
  @spec to_points(t()) :: [Vector3.t()]
  def to_points(%__MODULE__{points: points}) do
    # A generator over the floats would stop at the first value that is not finite.
    for <<point::binary-size(12) <- points>>,
        <<x::little-float-32, y::little-float-32, z::little-float-32>> <- [point],
        do: {x, y, z}
  end

  @doc "Returns the number of points."
  @spec point_count(t()) :: non_neg_integer()
  def point_count(%__MODULE__{points: points}), do: div(byte_size(points), 12)

  @doc "Returns the smallest axis-aligned box around all points, or `nil` for an empty cloud."
  @spec bounding_box(t()) :: Box3.t() | nil
  def bounding_box(%__MODULE__{} = cloud), do: cloud |> to_points() |> Box3.from_points()

  @doc "Returns the mean of all points, or `nil` for an empty cloud."
  @spec centroid(t()) :: Vector3.t() | nil
  def centroid(%__MODULE__{} = cloud) do
    case to_points(cloud) do
      [] -> nil
      points -> points |> Enum.reduce(&Vector3.add/2) |> Vector3.scale(1 / length(points))
    end
  end

  @doc """
  Transforms the cloud from the pose's local frame to the frame in which the pose is given. Colours and points whose
  coordinates are not finite are unchanged. `Situ.Space.Cloud.transform/2` is faster.
  """
  @spec transform(t(), Pose.t()) :: t()
  def transform(%__MODULE__{points: points} = cloud, %Pose{} = pose) do
    moved = for <<point::binary-size(12) <- points>>, into: <<>>, do: transform_point(point, pose)
    %{cloud | points: moved}
  end

  defp transform_point(<<x::little-float-32, y::little-float-32, z::little-float-32>>, pose) do
    {x, y, z} = Pose.transform_point(pose, {x, y, z})
    <<x::little-float-32, y::little-float-32, z::little-float-32>>
  end

  defp transform_point(not_finite, _pose), do: not_finite

  @impl Situ.Codec
  def codec_name, do: "situ.point_cloud"

  @impl Situ.Codec
  def encode(%__MODULE__{points: points, colors: colors} = cloud) do
    # Clouds in older recordings that are decoded as terms have no `values` field.
    values = Map.get(cloud, :values)
    flags = if(colors, do: 1, else: 0) + if(values, do: 2, else: 0)

    [<<1, flags, 0::16, div(byte_size(points), 12)::little-32>>, points] ++
      List.wrap(colors) ++ List.wrap(values)
  end

  @impl Situ.Codec
  def decode(<<1, flags, 0::16, count::little-32, rest::binary>>) when flags in 0..3 do
    colors = if rem(flags, 2) == 1, do: count, else: 0
    values = if flags >= 2, do: count, else: 0

    case rest do
      <<points::binary-pinned_size(count)-unit(96), rgb::binary-pinned_size(colors)-unit(24),
        floats::binary-pinned_size(values)-unit(32)>> ->
        new(points, if(rem(flags, 2) == 1, do: rgb), if(flags >= 2, do: floats))

      _ ->
        {:error,
         Error.new(:bad_cloud, "a stored cloud of #{count} points has #{byte_size(rest)} bytes")}
    end
  end

  def decode(_bytes), do: {:error, Error.new(:bad_cloud, "not a stored point cloud")}

  defimpl Inspect do
    def inspect(%{points: points} = cloud, _opts) when is_binary(points),
      do:
        "#Situ.PointCloud<#{Situ.PointCloud.point_count(cloud)} points#{if cloud.colors, do: ", coloured"}>"

    def inspect(_cloud, _opts), do: "#Situ.PointCloud<invalid>"
  end
end
