defmodule Situ.Space.Registration do
  @moduledoc """
  Relates a depth camera to another camera next to it. It finds the pixel of the other camera that corresponds to a
  depth pixel, the 3D point that a pixel of the other camera shows, and the colours of a point cloud.

  Both cameras are given as views (`Situ.CameraView`) with their intrinsics and with poses in the same frame. The
  calibration of a device (intrinsics for each camera, and the pose of one in the other's frame) yields two such views:

      color_pose = Situ.Pose.compose(depth_pose, color_in_depth_frame)

      iex> eye = Situ.CameraIntrinsics.new!(width: 4, height: 2, focal: {4, 4})
      iex> lens = Situ.CameraIntrinsics.new!(width: 40, height: 20, focal: {40, 40})
      iex> depth = Situ.DepthImage.new!(width: 4, height: 2, data: :binary.copy(<<2000::little-16>>, 8))
      iex> seen = Situ.CameraView.new(depth, eye, Situ.Pose.identity())
      iex> image = Situ.Image.new_filled(40, 20, :rgb24, :red)
      iex> beside = Situ.CameraView.new(image, lens, Situ.Pose.new({0.0, 0.1, 0.0}))
      iex> Situ.Space.Registration.project_pixel(seen, beside, {2, 1})
      {:ok, {22.0, 10.0}}
      iex> {:ok, colors} = Situ.Space.Registration.register_colors(seen, beside)
      iex> Situ.Image.fetch_pixel(colors, 2, 1)
      {:ok, [255, 0, 0]}
  """
  alias Situ.{CameraView, DepthImage, Error, Image, ImageOps, Pose, Quaternion, Vector3}
  alias Situ.Space.{Camera, Depth, NativeCall, RayTable}

  @doc """
  Returns the pixel of the other camera that shows the same point as a depth pixel (integers). Returns the error
  `:unknown` if nothing was measured there, and the errors of `Situ.Space.Camera`. It does not check for nearer objects
  that hide the point from the other camera.
  """
  @spec project_pixel(CameraView.t(DepthImage.t()), CameraView.t(), {integer(), integer()}) ::
          {:ok, Camera.pixel()} | {:error, :unknown | :not_invertible | :behind | :outside}
  def project_pixel(
        %CameraView{viewed: %DepthImage{} = depth} = seen,
        %CameraView{} = other,
        {x, y}
      ) do
    case DepthImage.fetch_distance(depth, x, y) do
      {:ok, distance} when is_number(distance) ->
        opts = [semantics: depth.semantics]

        with {:ok, point} <- Camera.unproject(seen.intrinsics, {x, y}, distance, opts),
             do: Camera.project_in_view(other, Pose.transform_point(seen.pose, point))

      _ ->
        {:error, :unknown}
    end
  end

  @doc """
  Returns the 3D point (in the frame of the poses) that a pixel of the other camera shows, or `nil` if the depth camera
  did not see it. Takes the options of `Situ.Space.Depth.intersect_ray/3`; the result is accurate to one `step`.
  """
  @spec find_point(CameraView.t(DepthImage.t()), CameraView.t(), Camera.pixel(), keyword()) ::
          Vector3.t() | nil
  def find_point(%CameraView{} = seen, %CameraView{} = other, pixel, opts \\ []) do
    case Camera.ray_in_view(other, pixel) do
      {:ok, ray} -> Depth.intersect_ray(seen, ray, opts)
      {:error, :not_invertible} -> nil
    end
  end

  @doc """
  Returns an image of the depth image's size with the colours that the other camera saw, for
  `Situ.Space.Depth.to_cloud/3` (`colors:`). Pixels are black where nothing was measured and outside the other image.

  `table:` is the depth camera's `Situ.Space.RayTable`, to reuse for many images.
  """
  @spec register_colors(CameraView.t(DepthImage.t()), CameraView.t(Image.t()), keyword()) ::
          {:ok, Image.t()} | {:error, Error.t()}
  def register_colors(seen, other, opts \\ [])

  def register_colors(
        %CameraView{viewed: %DepthImage{} = depth} = seen,
        %CameraView{viewed: %Image{} = picture} = other,
        opts
      ) do
    c = other.intrinsics

    lens =
      {picture.width, picture.height, c.focal, c.principal, c.radial, c.tangential, c.distorts?}

    between = Pose.compose(Pose.invert(other.pose), seen.pose)

    with :ok <- check_image_size(picture, c),
         {:ok, table} <- RayTable.ensure_table(opts[:table] || seen.intrinsics),
         {:ok, rgb} <- ImageOps.convert(picture, :rgb24),
         from =
           {lens, Image.pixel_bytes(rgb), Quaternion.to_matrix(between.rotation),
            between.position},
         {:ok, data} <-
           NativeCall.call_native(:depth_colors, [Depth.to_kernel_term(depth), table.rays, from]),
         do: Image.new(width: depth.width, height: depth.height, format: :rgb24, data: data)
  end

  def register_colors(_seen, _other, _opts) do
    {:error,
     Error.new(:bad_image, "registration needs a view of depth and a view of an image",
       fix: "decode the image first: Situ.Space.ViewImage.decode/2"
     )}
  end

  defp check_image_size(%{width: w, height: h}, %{width: w, height: h}), do: :ok

  defp check_image_size(picture, camera) do
    {:error,
     Error.new(
       :bad_camera,
       "the image has #{picture.width}x#{picture.height} pixels, its intrinsics #{camera.width}x#{camera.height}",
       fix: "resize views with Situ.Space.ViewImage.resize/4, which also resizes their intrinsics"
     )}
  end
end
