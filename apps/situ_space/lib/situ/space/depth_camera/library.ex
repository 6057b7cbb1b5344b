defmodule Situ.Space.DepthCamera.Library do
  @moduledoc """
  A depth camera that is supported by a library in Debian: OpenNI 2 for cameras of PrimeSense, Asus (Xtion) and
  compatible ones, libfreenect for the Kinect for Xbox 360.

      camera = Situ.Space.DepthCamera.open(p, Situ.Space.DepthCamera.Library)
      kinect = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Library, device: "freenect:0"})

  The libraries run in the separate program `depth_port`, which `bin/setup --with depth` builds, so a crash ends only
  that program. `list_cameras/0` and `situ devices` list the connected cameras. `"fakenect:FOLDER"` replays a folder
  written by libfreenect's `fakenect-record`, at its original speed.

  Depth is in millimetres. libfreenect registers a Kinect's depth to its colour image (but not the depth of a folder).
  Timestamps are arrival times in the program. A camera cannot wait: images that are not taken in time are dropped,
  newest first, and `Situ.Pipeline.info/1` shows how many.

  This was not tried on hardware. The tests use OpenNI's dummy device and folders in the format of `fakenect-record`.
  libfreenect's tilt motor, light, microphones and accelerometer are not read.

  Errors when the pipeline starts: `:no_depth_port`, `:no_camera` (with the library's message), `:no_intrinsics` if the
  library does not report them, `:bad_camera` if images and intrinsics differ in size.
  """

  @schema [
    device: [
      type: :string,
      default: "openni2:",
      doc:
        "`\"openni2:URI\"`, `\"freenect:INDEX\"` (the first if URI or INDEX is empty), or `\"fakenect:FOLDER\"`."
    ],
    intrinsics: [
      type: {:optional, {:struct, Situ.CameraIntrinsics}},
      default: nil,
      doc: "The intrinsics of the depth camera; by default as reported by the library."
    ],
    color_intrinsics: [
      type: {:optional, {:struct, Situ.CameraIntrinsics}},
      default: nil,
      doc:
        "The intrinsics of the colour camera; by default as reported by the library, or else the depth camera's."
    ],
    pose: [
      type: {:optional, {:struct, Situ.Pose}},
      default: nil,
      doc: "The camera's pose; `nil` is the origin, looking along x."
    ],
    reconnect: [
      type: :boolean,
      default: true,
      doc: "Whether to reconnect every second after a running camera was lost."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "A camera that sends nothing for this long (ns) counts as lost."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  # See docs/adr/0105-large-libraries-run-in-separate-programs.md. Times are times of arrival,
  # because the clocks of devices start at any value, and one of them wraps after 71 s.
  @behaviour Situ.Space.DepthCamera
  alias Situ.{Error, Pose}
  alias Situ.Media.Device
  alias Situ.Space.DepthCamera
  alias Situ.Space.DepthCamera.Library.{PortProgram, Source}

  @impl true
  def open(p, opts) do
    opts = Situ.Options.validate!(opts, @schema)
    Error.unwrap!(PortProgram.device_arguments(opts[:device]))
    opts = Keyword.update!(opts, :pose, &(&1 || Pose.identity()))
    seen = Situ.source(p, Source, opts ++ [name: "Depth camera", async: true])
    %DepthCamera{depth: seen.depth, color: seen.color}
  end

  @doc "Returns whether `depth_port` was built."
  @spec available?() :: boolean()
  def available?, do: match?({:ok, _}, PortProgram.fetch_path())

  @doc "Lists the cameras that the libraries find, or returns an empty list if `depth_port` was not built."
  @spec list_cameras() :: [Device.t()]
  def list_cameras do
    for line <- PortProgram.list_cameras(),
        [driver, address, name] <- [String.split(line, "\t")] do
      %Device{id: "#{driver}:#{address}", kind: :depth_camera, name: String.trim(name)}
    end
  end
end
