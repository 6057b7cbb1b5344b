defmodule Situ.CameraView do
  @moduledoc """
  One camera view: an image (`Situ.Image`, `Situ.EncodedImage`, `Situ.DepthImage`) or a point cloud, the
  intrinsics of the camera, and its pose.

      iex> camera = Situ.CameraIntrinsics.new!(width: 4, height: 2, focal: {4, 4})
      iex> view = Situ.CameraView.new(Situ.Image.new_filled(4, 2, :gray8), camera, Situ.Pose.identity())
      iex> {view.viewed.width, view.intrinsics.principal}
      {4, {2.0, 1.0}}
  """
  alias Situ.{CameraIntrinsics, Pose}

  @enforce_keys [:viewed, :intrinsics, :pose]
  defstruct [:viewed, :intrinsics, :pose]

  @type t :: t(Situ.Image.t() | Situ.EncodedImage.t() | Situ.DepthImage.t() | Situ.PointCloud.t())
  @type t(viewed) :: %__MODULE__{viewed: viewed, intrinsics: CameraIntrinsics.t(), pose: Pose.t()}

  @doc "Builds the view of a camera with these intrinsics at this pose."
  @spec new(viewed, CameraIntrinsics.t(), Pose.t()) :: t(viewed) when viewed: term()
  def new(viewed, %CameraIntrinsics{} = intrinsics, %Pose{} = pose),
    do: %__MODULE__{viewed: viewed, intrinsics: intrinsics, pose: pose}

  @doc """
  Replaces the viewed data with the result of `fun`, for example to encode the image, convert it or turn it into a
  cloud. To change the image size, use `Situ.Space.ViewImage`, which also adjusts the intrinsics.
  """
  @spec map_viewed(t(viewed), (viewed -> {:ok, other} | {:error, error})) ::
          {:ok, t(other)} | {:error, error}
        when viewed: term(), other: term(), error: term()
  def map_viewed(%__MODULE__{} = view, fun) when is_function(fun, 1) do
    with {:ok, viewed} <- fun.(view.viewed), do: {:ok, %{view | viewed: viewed}}
  end
end
