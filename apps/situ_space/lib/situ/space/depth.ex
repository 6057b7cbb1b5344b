defmodule Situ.Space.Depth do
  @moduledoc """
  Computes point clouds and meshes from depth images, and the point where a ray meets the surface in a depth image.

  A camera is given by its intrinsics or, faster for many images, by its `Situ.Space.RayTable`.

      iex> camera = Situ.CameraIntrinsics.new!(width: 2, height: 1, focal: {1, 1}, principal: {0, 0})
      iex> depth = Situ.DepthImage.new!(width: 2, height: 1, data: <<1000::little-16, 2000::little-16>>)
      iex> {:ok, cloud} = Situ.Space.Depth.to_cloud(depth, camera)
      iex> Situ.PointCloud.to_points(cloud)
      [{1.0, -0.0, -0.0}, {2.0, -2.0, -0.0}]
  """
  alias Situ.{
    CameraIntrinsics,
    CameraView,
    DepthImage,
    Error,
    Mesh,
    PointCloud,
    Pose,
    Ray3,
    Vector3
  }

  alias Situ.Space.{Camera, NativeCall, RayTable}

  @type camera :: CameraIntrinsics.t() | RayTable.t()

  @cloud [
    sparsity: [type: :pos_integer, default: 1, doc: "Use every n-th pixel of every n-th row."],
    robust: [
      type: :boolean,
      default: false,
      doc: "Use only pixels whose eight neighbours were also measured."
    ],
    colors: [
      type: {:optional, {:struct, Situ.Image}},
      default: nil,
      doc:
        "An image of the same size and viewpoint that gives the points their colours; " <>
          "`Situ.Space.Registration` computes one from another camera's image."
    ]
  ]

  @doc """
  Returns the points that a depth image shows, in the camera's frame. Pixels without a reading (0) yield no point.

  #{Situ.Options.docs(@cloud)}
  """
  @spec to_cloud(DepthImage.t(), camera(), keyword()) ::
          {:ok, PointCloud.t()} | {:error, Error.t()}
  def to_cloud(%DepthImage{} = depth, camera, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @cloud),
         {:ok, table} <- RayTable.ensure_table(camera),
         {:ok, colors} <- rgb_pixels(opts[:colors], depth),
         arguments = [to_kernel_term(depth), table.rays, opts[:sparsity], opts[:robust], colors],
         {:ok, {points, tones}} <- NativeCall.call_native(:depth_cloud, arguments),
         do: PointCloud.new(points, if(opts[:colors], do: tones))
  end

  defp rgb_pixels(nil, _depth), do: {:ok, <<>>}

  defp rgb_pixels(%Situ.Image{width: w, height: h} = picture, %DepthImage{width: w, height: h}) do
    with {:ok, rgb} <- Situ.ImageOps.convert(picture, :rgb24),
         do: {:ok, Situ.Image.pixel_bytes(rgb)}
  end

  defp rgb_pixels(picture, depth) do
    {:error,
     Error.new(
       :bad_option,
       "the image has #{picture.width}x#{picture.height} pixels, the depth image #{depth.width}x#{depth.height}",
       fix: "resize the image or the depth image to the size of the other"
     )}
  end

  @mesh [
    edge: [
      type: :number,
      default: 0.2,
      doc: "Drops triangles whose corners differ in depth by more than this, metres."
    ],
    sparsity: [type: :pos_integer, default: 1, doc: "Use every n-th pixel of every n-th row."]
  ]

  @doc """
  Returns the surface that a depth image shows, as triangles between neighbouring pixels, in the camera's frame.

  #{Situ.Options.docs(@mesh)}
  """
  @spec to_mesh(DepthImage.t(), camera(), keyword()) :: {:ok, Mesh.t()} | {:error, Error.t()}
  def to_mesh(%DepthImage{} = depth, camera, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @mesh),
         {:ok, table} <- RayTable.ensure_table(camera),
         arguments = [to_kernel_term(depth), table.rays, opts[:edge] * 1.0, opts[:sparsity]],
         {:ok, {vertices, indices}} <- NativeCall.call_native(:depth_mesh, arguments),
         do: Mesh.new(vertices, indices)
  end

  @doc false
  # Converts a depth image to the tuple that the native kernels expect.
  @spec to_kernel_term(DepthImage.t()) :: tuple()
  def to_kernel_term(%DepthImage{} = d),
    do: {d.width, d.height, d.stride, d.data, d.scale, d.semantics == :point}

  @march [
    step: [
      type: :number,
      default: 0.05,
      doc: "The distance between samples along the ray, metres."
    ],
    range: [type: :number, default: 5.0, doc: "The maximum distance along the ray, metres."]
  ]

  @doc """
  Returns the point where a ray of the outer frame first meets the surface that the camera of a view saw. This is the
  first step at which the ray is farther away than the measured depth. Returns `nil` if the ray meets nothing within
  the range or leaves the image. Missing depths are interpolated (`Situ.DepthImage.interpolated_distance/4`).

  #{Situ.Options.docs(@march)}
  """
  @spec intersect_ray(CameraView.t(DepthImage.t()), Ray3.t(), keyword()) :: Vector3.t() | nil
  def intersect_ray(%CameraView{viewed: %DepthImage{}} = view, %Ray3{} = ray, opts \\ []) do
    opts = Situ.Options.validate!(opts, @march)
    local = Ray3.transform(ray, Pose.invert(view.pose))
    # The small term compensates for rounding, so that 0.3 m is three steps of 0.1 m.
    steps = trunc(opts[:range] / opts[:step] + 1.0e-9)

    Enum.find_value(1..max(steps, 1)//1, fn n ->
      point = Ray3.point_at(local, n * opts[:step])
      if behind_surface?(view, point), do: Pose.transform_point(view.pose, point)
    end)
  end

  defp behind_surface?(%{viewed: depth, intrinsics: camera}, {x, _, _} = point) do
    with {:ok, {px, py}} <- Camera.project(camera, point),
         {:ok, measured} when is_number(measured) <-
           DepthImage.interpolated_distance(depth, trunc(px), trunc(py)) do
      measured < if(depth.semantics == :point, do: Vector3.norm(point), else: x)
    else
      _ -> false
    end
  end
end
