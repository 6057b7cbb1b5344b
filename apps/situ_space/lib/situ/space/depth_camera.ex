defmodule Situ.Space.DepthCamera do
  @moduledoc """
  A camera that measures depth, opened in the same way for every driver.

      room = Situ.Space.DepthCamera.open(p, {Situ.Space.SyntheticRoom, seconds: 10})
      seen = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Recording, path: "recordings/room.0000"})
      cloud = Situ.Space.DepthCamera.clouds(seen)

  Both streams carry `Situ.CameraView`s: each image comes with its intrinsics and pose, so a computation needs no other
  input. A driver is a module with this behaviour. Drivers:

    * `Situ.Space.SyntheticRoom`: a rendered room with ground truth
    * `Situ.Space.DepthCamera.Device`: a Linux kernel device that delivers depth in V4L2's Z16 format
    * `Situ.Space.DepthCamera.Library`: a camera supported by OpenNI 2 or libfreenect
    * `Situ.Space.DepthCamera.Recording`: a recording of any of these cameras
  """
  # A depth image is meaningless without its intrinsics and pose, so every message contains them:
  # 20 numbers next to an image of 614,400 bytes. Few users have a depth camera, so a synthetic
  # room stands in for one, as a pure function of time with ground truth. It costs 20 ms of CPU
  # time per image of 640x480.
  alias Situ.{CameraView, DepthImage, Error, PointCloud}
  alias Situ.Space.{Cloud, Depth, Registration}

  @enforce_keys [:depth, :color]
  defstruct [:depth, :color, others: %{}]

  @typedoc "`others` are streams that only some cameras have: bodies, audio, an inertial sensor."
  @type t :: %__MODULE__{
          depth: Situ.Stream.t(),
          color: Situ.Stream.t() | nil,
          others: %{optional(atom()) => Situ.Stream.t()}
        }

  @doc "Adds the camera to a pipeline. Raises `Situ.Error` if it cannot be opened."
  @callback open(Situ.Pipeline.t(), keyword()) :: t()

  @doc "Opens the camera of a driver, given as a module or as a module with options."
  @spec open(Situ.Pipeline.t(), module() | {module(), keyword()}) :: t()
  def open(p, {driver, opts}) when is_atom(driver) and is_list(opts), do: driver.open(p, opts)
  def open(p, driver) when is_atom(driver), do: driver.open(p, [])

  @clouds [
    sparsity: [type: :pos_integer, default: 1, doc: "Use every n-th pixel of every n-th row."],
    robust: [
      type: :boolean,
      default: false,
      doc: "Use only pixels whose eight neighbours were also measured."
    ]
  ]

  @doc """
  Returns a stream of the points that the camera sees, in the frame in which its poses are given.

  #{Situ.Options.docs(@clouds)}
  """
  @spec clouds(t(), keyword()) :: Situ.Stream.t()
  def clouds(%__MODULE__{depth: depth}, opts \\ []) do
    {opts, placed} = Keyword.split(opts, Keyword.keys(@clouds))
    opts = Situ.Options.validate!(opts, @clouds)

    Situ.map(
      depth,
      &(&1 |> view_to_cloud(opts) |> Error.unwrap!()),
      [name: "Clouds", type: PointCloud] ++ placed
    )
  end

  @doc """
  Returns the points of one view, in the frame in which its pose is given. Takes the options of
  `Situ.Space.Depth.to_cloud/3`. `colors:` may also be the view of another camera, with its lens and pose
  (`Situ.Space.Registration`).
  """
  @spec view_to_cloud(CameraView.t(DepthImage.t()), keyword()) ::
          {:ok, PointCloud.t()} | {:error, Error.t()}
  def view_to_cloud(%CameraView{viewed: %DepthImage{} = depth} = view, opts \\ []) do
    with {:ok, opts} <- resolve_colors(view, opts[:colors], opts),
         {:ok, points} <- Depth.to_cloud(depth, view.intrinsics, opts),
         do: Cloud.transform(points, view.pose)
  end

  defp resolve_colors(view, %CameraView{} = other, opts) do
    with {:ok, colors} <- Registration.register_colors(view, other),
         do: {:ok, Keyword.put(opts, :colors, colors)}
  end

  defp resolve_colors(_view, _picture, opts), do: {:ok, opts}
end
