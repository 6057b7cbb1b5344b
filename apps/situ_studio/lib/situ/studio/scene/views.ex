defmodule Situ.Studio.Scene.Views do
  @moduledoc false
  # Converts camera views to items at the cameras' poses.
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, PointCloud, Pose}
  alias Situ.Space.{Camera, Cloud, Depth}
  alias Situ.Studio.Scene
  alias Situ.Studio.Scene.Surfaces

  @doc "Builds the view pyramid of a camera, 1 m deep."
  @spec frustum(CameraIntrinsics.t(), Pose.t(), String.t() | nil) :: Scene.item()
  def frustum(camera, pose, label) do
    points = Enum.flat_map([pose.position | corners(camera, pose)], &Tuple.to_list/1)
    Scene.item(:frusta, 1, [corner: Scene.floats(points)], %{"names" => [label || "camera"]})
  end

  # Returns the positions of the image's corners, 1 m in front of the camera.
  defp corners(%CameraIntrinsics{width: w, height: h} = camera, pose) do
    for {x, y} <- [{0, 0}, {w, 0}, {w, h}, {0, h}],
        do: Pose.transform(pose, corner(camera, {x, y}))
  end

  defp corner(camera, pixel) do
    with {:error, _} <- Camera.unproject(camera, pixel, 1.0),
         do: Camera.unproject(camera, pixel, 1.0, undistort: false) |> elem(1),
         else: ({:ok, point} -> point)
  end

  @doc "Builds intrinsics from a focal length in pixels, for an image whose intrinsics are unknown."
  @spec assumed(struct(), number()) :: CameraIntrinsics.t()
  def assumed(%{width: w, height: h}, focal),
    do: CameraIntrinsics.new!(width: w, height: h, focal: {focal, focal})

  @doc "Builds the item of a view's image: the image on its plane, or depth as points or as a surface."
  @spec seen(CameraView.t(), map()) :: Surfaces.result()
  def seen(%CameraView{viewed: %DepthImage{} = depth} = view, %{depth_as: as} = settings)
      when as != "picture" do
    with {:ok, sparsity} <- sparsity(depth, settings) do
      if as == "surface",
        do: surface(view, sparsity),
        else: points(view, sparsity, settings)
    end
  end

  def seen(%CameraView{viewed: viewed, intrinsics: camera, pose: pose}, _settings),
    do: Surfaces.picture(viewed, corners(camera, pose), %{"apex" => Tuple.to_list(pose.position)})

  defp sparsity(%DepthImage{width: w, height: h}, %{budget: budget, sparsity: least})
       when is_integer(w) and is_integer(h),
       do: {:ok, max(least, ceil(:math.sqrt(w * h / budget)))}

  defp sparsity(_depth, _settings), do: {:error, "a depth image without a size"}

  defp surface(view, sparsity) do
    case Depth.to_mesh(view.viewed, view.intrinsics, sparsity: sparsity) do
      {:ok, mesh} -> Surfaces.mesh(%{mesh | pose: view.pose}, "surface")
      {:error, error} -> {:error, error.what}
    end
  end

  defp points(view, sparsity, settings) do
    case Depth.to_cloud(view.viewed, view.intrinsics, sparsity: sparsity) do
      {:ok, cloud} -> cloud(cloud, view.pose, settings)
      {:error, error} -> {:error, error.what}
    end
  end

  @doc "Builds the item of a point cloud in a camera's frame."
  @spec cloud(PointCloud.t(), Pose.t(), map()) :: Surfaces.result()
  def cloud(cloud, pose, settings) do
    case cloud |> Map.put_new(:values, nil) |> Cloud.transform(pose) do
      {:ok, cloud} -> Surfaces.cloud(cloud, nil, settings)
      {:error, error} -> {:error, error.what}
    end
  end
end
