defmodule Situ.CameraView do
  @moduledoc """
  One view of a camera: a picture (`Situ.Image`, `Situ.EncodedImage`, `Situ.DepthImage`) or a point cloud, the
  camera's intrinsics, and its pose.
  """
  alias Situ.{CameraIntrinsics, Pose}

  @enforce_keys [:viewed, :intrinsics, :pose]
  defstruct [:viewed, :intrinsics, :pose]

  @type t :: t(Situ.Image.t() | Situ.EncodedImage.t() | Situ.DepthImage.t() | Situ.PointCloud.t())
  @type t(viewed) :: %__MODULE__{viewed: viewed, intrinsics: CameraIntrinsics.t(), pose: Pose.t()}

  @doc "The view of a camera with these intrinsics at this pose."
  @spec new(viewed, CameraIntrinsics.t(), Pose.t()) :: t(viewed) when viewed: term()
  def new(viewed, %CameraIntrinsics{} = intrinsics, %Pose{} = pose),
    do: %__MODULE__{viewed: viewed, intrinsics: intrinsics, pose: pose}

  @doc """
  The same view of something else that the camera saw: its picture encoded, converted, or turned to a cloud.
  `Situ.Space.View` changes a picture's size, and the intrinsics with it.
  """
  @spec map(t(viewed), (viewed -> {:ok, other} | {:error, error})) ::
          {:ok, t(other)} | {:error, error}
        when viewed: term(), other: term(), error: term()
  def map(%__MODULE__{} = view, fun) when is_function(fun, 1) do
    with {:ok, viewed} <- fun.(view.viewed), do: {:ok, %{view | viewed: viewed}}
  end
end
