defmodule Situ.Media.Camera do
  alias Situ.Media.Device

  @schema [
    device: [
      type: {:or, [:string, {:tuple, [:module, :string]}]},
      default: "v4l2:/dev/video0",
      doc: "Which camera, see `Situ.Media.Device`."
    ],
    size: [
      type: {:optional, {:tuple, [:pos_integer, :pos_integer]}},
      default: {1280, 720},
      doc: "`{width, height}`; `nil`: as the device gives them."
    ],
    rate: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Pictures a second; `nil`: the device's own rate."
    ],
    format: [
      type: {:in, Situ.Image.Format.all()},
      default: :bgr24,
      doc: "Pixel format of the pictures."
    ],
    input_format: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The format a V4L2 camera should send: `\"mjpeg\"`, `\"yuyv422\"` ...; `nil`: its first."
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
      doc: "Pictures that may wait for a slow pipeline; then the oldest is dropped."
    ],
    reconnect: [
      type: {:optional, :boolean},
      default: nil,
      doc:
        "When the camera is lost while it runs, try again every second; `nil`: yes, unless it has an end (`?once`)."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "A camera that sends nothing for so long (ns) counts as lost."
    ],
    args: [type: {:list, :string}, default: [], doc: "More input options for `ffmpeg`."]
  ]

  @moduledoc """
  A camera as a source: pictures at the times they were taken.

      camera = Situ.Media.Camera.open(p, device: "/dev/video0", size: {1280, 720}, rate: 30)
      camera = Situ.Media.Camera.open(p, device: "simulated:talk1.mp4")

  The kinds of devices: `Situ.Media.Device`; `situ devices` lists the ones that are there. A camera cannot wait:
  pictures that nobody takes in time are dropped, the oldest first, and counted (`Situ.Pipeline.info/1` shows how
  many). A camera that is not there when the pipeline starts is an error; one that is lost later is tried again.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component, outputs: [out: Situ.Image], options: @schema
  use Situ.Media.Capture

  @doc "Adds the camera to a pipeline; returns its stream."
  @spec open(Situ.Pipeline.t(), keyword()) :: Situ.Stream.t()
  def open(p, opts \\ []), do: Situ.source(p, __MODULE__, Keyword.put_new(opts, :async, true))

  @doc "The cameras there are."
  @spec list() :: [Device.t()]
  def list, do: Enum.filter(Device.list(), &(&1.kind == :camera))

  @doc """
  The controls of a V4L2 camera: brightness, contrast, exposure, focus, white balance ...; empty for other devices.

      controls = Situ.Media.Camera.controls("/dev/video0")
      #=> [%{name: "brightness", type: "int", min: -64, max: 64, step: 1, default: 0, value: 0}, ...]
      Situ.Media.Camera.open(p, controls: [{"auto_exposure", 1}, {"exposure_time_absolute", 150}])
  """
  @spec controls(Device.device()) :: [Device.V4L2.control()]
  def controls(device) do
    case Device.parse(device) do
      {:ok, {Device.V4L2, path}} -> Device.V4L2.controls(path)
      _ -> []
    end
  end

  @impl true
  def init(opts), do: Capture.new(opts[:device], %{video: :out}, opts)
end
