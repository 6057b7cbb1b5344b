defmodule Situ.Media.Camera do
  @moduledoc """
  A camera as a source of images, stamped with the times at which they were taken.

      camera = Situ.Media.Camera.open(p, device: "/dev/video0", size: {1280, 720}, rate: 30)
      camera = Situ.Media.Camera.open(p, device: "simulated:talk1.mp4")

  `Situ.Media.Device` lists the kinds of devices, and `situ devices` lists the available ones. A camera cannot wait:
  images that the pipeline does not take in time are dropped, oldest first, and counted (`Situ.Pipeline.info/1` shows
  the count). A camera that is missing when the pipeline starts is an error; a camera that is lost later is retried.
  """

  alias Situ.Media.Device

  @schema [
    device: [
      type: {:or, [:string, {:tuple, [:module, :string]}]},
      default: "v4l2:/dev/video0",
      doc: "The camera, see `Situ.Media.Device`."
    ],
    size: [
      type: {:optional, {:tuple, [:pos_integer, :pos_integer]}},
      default: {1280, 720},
      doc: "`{width, height}`; `nil`: the device's own size."
    ],
    rate: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Images per second; `nil`: the device's own rate."
    ],
    format: [
      type: {:in, Situ.Image.Format.list_all()},
      default: :bgr24,
      doc: "Pixel format of the images."
    ],
    input_format: [
      type: {:optional, :string},
      default: nil,
      doc:
        "Format to request from a V4L2 camera: `\"mjpeg\"`, `\"yuyv422\"` ...; `nil`: the camera's first format."
    ],
    controls: [
      type: {:list, {:tuple, [:string, :integer]}},
      default: [],
      doc:
        "Controls to set each time a V4L2 camera is opened, `[{\"brightness\", 20}]`: see `controls/1`."
    ],
    buffer: [
      type: :pos_integer,
      default: 2,
      doc: "Number of images that may wait for a slow pipeline; beyond it the oldest is dropped."
    ],
    reconnect: [
      type: {:optional, :boolean},
      default: nil,
      doc:
        "Retry every second if the camera is lost while running; `nil`: yes, unless the source has an end (`?once`)."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "Time without data (ns) after which the camera counts as lost."
    ],
    args: [type: {:list, :string}, default: [], doc: "Additional input options for `ffmpeg`."]
  ]

  use Situ.Component, outputs: [out: Situ.Image], options: @schema
  use Situ.Media.Capture

  @doc "Adds the camera to a pipeline and returns its stream."
  @spec open(Situ.Pipeline.t(), keyword()) :: Situ.Stream.t()
  def open(p, opts \\ []), do: Situ.source(p, __MODULE__, Keyword.put_new(opts, :async, true))

  @doc "Lists the available cameras."
  @spec list_devices() :: [Device.t()]
  def list_devices, do: Enum.filter(Device.list(), &(&1.kind == :camera))

  @doc """
  Returns the controls of a V4L2 camera (brightness, contrast, exposure, focus, white balance, ...), or `[]` for other
  devices.

      controls = Situ.Media.Camera.controls("/dev/video0")
      #=> [%{name: "brightness", type: "int", min: -64, max: 64, step: 1, default: 0, value: 0}, ...]
      Situ.Media.Camera.open(p, controls: [{"auto_exposure", 1}, {"exposure_time_absolute", 150}])
  """
  @spec controls(Device.device()) :: [Device.V4L2.control()]
  def controls(device) do
    case Device.parse_name(device) do
      {:ok, {Device.V4L2, path}} -> Device.V4L2.list_controls(path)
      _ -> []
    end
  end

  @impl true
  def init(opts), do: Capture.new(opts[:device], %{video: :out}, opts)
end
