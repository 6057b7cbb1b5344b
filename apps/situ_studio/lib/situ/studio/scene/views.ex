defmodule Situ.Studio.Scene.Views do
  @moduledoc false
  # Converts camera views to items at the cameras' poses.
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, PointCloud, Pose}
  alias Situ.Space.{Camera, Cloud, Depth}
  alias Situ.Studio.Scene
  alias Situ.Studio.Scene.Surfaces

  @doc "Builds the view pyramid of a camera, 1 m deep."
  @spec frustum_item(CameraIntrinsics.t(), Pose.t(), String.t() | nil) :: Scene.item()
  def frustum_item(camera, pose, label) do
    points = Enum.flat_map([pose.position | image_corners(camera, pose)], &Tuple.to_list/1)

    Scene.new_item(:frusta, 1, [corner: Scene.encode_floats(points)], %{
      "names" => [label || "camera"]
    })
  end

  # Returns the positions of the image's corners, 1 m in front of the camera.
  defp image_corners(%CameraIntrinsics{width: w, height: h} = camera, pose) do
    for {x, y} <- [{0, 0}, {w, 0}, {w, h}, {0, h}],
        do: Pose.transform_point(pose, unproject_corner(camera, {x, y}))
  end

  defp unproject_corner(camera, pixel) do
    with {:error, _} <- Camera.unproject(camera, pixel, 1.0),
         do: Camera.unproject(camera, pixel, 1.0, undistort: false) |> elem(1),
         else: ({:ok, point} -> point)
  end

  @doc "Builds intrinsics from a focal length in pixels, for an image whose intrinsics are unknown."
  @spec assume_intrinsics(struct(), number()) :: CameraIntrinsics.t()
  def assume_intrinsics(%{width: w, height: h}, focal),
    do: CameraIntrinsics.new!(width: w, height: h, focal: {focal, focal})

  @doc "Builds the item of a view's image: the image on its plane, or depth as points or as a surface."
  @spec view_item(CameraView.t(), map()) :: Surfaces.result()
  def view_item(%CameraView{viewed: %DepthImage{} = depth} = view, %{depth_as: as} = settings)
      when as != "picture" do
    with {:ok, sparsity} <- depth_sparsity(depth, settings) do
      if as == "surface",
        do: surface_item(view, sparsity),
        else: points_item(view, sparsity, settings)
    end
  end

  def view_item(%CameraView{viewed: viewed, intrinsics: camera, pose: pose}, _settings),
    do:
      Surfaces.image_item(viewed, image_corners(camera, pose), %{
        "apex" => Tuple.to_list(pose.position)
      })

  defp depth_sparsity(%DepthImage{width: w, height: h}, %{budget: budget, sparsity: least})
       when is_integer(w) and is_integer(h),
       do: {:ok, max(least, ceil(:math.sqrt(w * h / budget)))}

  defp depth_sparsity(_depth, _settings), do: {:error, "a depth image without a size"}

  defp surface_item(view, sparsity) do
    case Depth.to_mesh(view.viewed, view.intrinsics, sparsity: sparsity) do
      {:ok, mesh} -> Surfaces.mesh_item(%{mesh | pose: view.pose}, "surface")
      {:error, error} -> {:error, error.what}
    end
  end

  defp points_item(view, sparsity, settings) do
    case Depth.to_cloud(view.viewed, view.intrinsics, sparsity: sparsity) do
      {:ok, cloud} -> cloud_item(cloud, view.pose, settings)
      {:error, error} -> {:error, error.what}
    end
  end

  @doc "Builds the item of a point cloud in a camera's frame."
  @spec cloud_item(PointCloud.t(), Pose.t(), map()) :: Surfaces.result()
  def cloud_item(cloud, pose, settings) do
    case cloud |> Map.put_new(:values, nil) |> Cloud.transform(pose) do
      {:ok, cloud} -> Surfaces.cloud_item(cloud, nil, settings)
      {:error, error} -> {:error, error.what}
    end
  end
end
