defmodule Situ.Space.DepthCamera.Library do
  @schema [
    device: [
      type: :string,
      default: "openni2:",
      doc:
        "`\"openni2:URI\"`, `\"freenect:INDEX\"` (without a URI or an index: the first), or `\"fakenect:FOLDER\"`."
    ],
    intrinsics: [
      type: {:optional, {:struct, Situ.CameraIntrinsics}},
      default: nil,
      doc: "The lens of depth; `nil`: as the library tells it."
    ],
    color_intrinsics: [
      type: {:optional, {:struct, Situ.CameraIntrinsics}},
      default: nil,
      doc: "The lens of colour; `nil`: as the library tells it, or else that of depth."
    ],
    pose: [
      type: {:optional, {:struct, Situ.Pose}},
      default: nil,
      doc: "Where the camera is; `nil`: at the origin, looking along x."
    ],
    reconnect: [
      type: :boolean,
      default: true,
      doc: "When the camera is lost while it runs, try again every second."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "A camera that sends nothing for so long (ns) counts as lost."
    ]
  ]

  @moduledoc """
  A depth camera that a library of Debian's knows: by OpenNI 2 those of PrimeSense, Asus (Xtion) and their kin, by
  libfreenect the Kinect for Xbox 360.

      camera = Situ.Space.DepthCamera.open(p, Situ.Space.DepthCamera.Library)
      kinect = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Library, device: "freenect:0"})

  The libraries run in the program `depth_port` beside, which `bin/setup --with depth` builds: one that crashes ends
  that program only. `list/0` and `situ devices` name the cameras that are there. `"fakenect:FOLDER"` plays a folder
  that libfreenect's `fakenect-record` has written, at its own speed.

  Depth is in millimetres; a Kinect's lies on its colour picture, as libfreenect registers it (that of a folder does
  not). Times are those of the arrival in the program. A camera cannot wait: pictures that nobody takes in time are
  lost, the newest first, and `Situ.Pipeline.info/1` shows how many.

  Not tried on hardware: OpenNI's own dummy device and folders as `fakenect-record` writes them are in the tests.
  libfreenect's tilt motor, light, microphones and acceleration are not read.

  Errors, when the pipeline starts: `:no_depth_port`, `:no_camera` (with the library's words), `:no_intrinsics` where
  the library does not tell the lens, `:bad_camera` where pictures have another size than the lens.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  @behaviour Situ.Space.DepthCamera
  alias Situ.{Error, Pose}
  alias Situ.Media.Device
  alias Situ.Space.DepthCamera
  alias Situ.Space.DepthCamera.Library.{Program, Reader}

  @impl true
  def open(p, opts) do
    opts = Situ.Options.validate!(opts, @schema)
    Error.unwrap!(Program.arguments(opts[:device]))
    opts = Keyword.update!(opts, :pose, &(&1 || Pose.identity()))
    seen = Situ.source(p, Reader, opts ++ [name: "Depth camera", async: true])
    %DepthCamera{depth: seen.depth, color: seen.color}
  end

  @doc "Whether `depth_port` was built."
  @spec available?() :: boolean()
  def available?, do: match?({:ok, _}, Program.path())

  @doc "The cameras that the libraries find; none where `depth_port` was not built."
  @spec list() :: [Device.t()]
  def list do
    for line <- Program.list(), [driver, address, name] <- [String.split(line, "\t")] do
      %Device{id: "#{driver}:#{address}", kind: :depth_camera, name: String.trim(name)}
    end
  end
end
