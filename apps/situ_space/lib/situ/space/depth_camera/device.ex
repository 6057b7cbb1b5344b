defmodule Situ.Space.DepthCamera.Device do
  @moduledoc """
  A depth camera that is a device of the Linux kernel and delivers V4L2's format Z16, 16 bits per pixel (RealSense
  cameras and others with such drivers).

      lens = Situ.CameraIntrinsics.new!(width: 640, height: 480, focal: {383, 383}, principal: {320, 240})
      camera = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Device, device: "/dev/video2", intrinsics: lens})

  `situ devices` lists the nodes of a camera with their formats; the node with `Z16` delivers depth. Timestamps, dropped
  images and the loss of the camera are handled as in `Situ.Media.Camera`. The tests use a device that FFmpeg
  synthesizes (`lavfi:`); it was not tried on hardware. If the images and the intrinsics differ in size, an error
  reports both sizes.
  """

  @schema [
    device: [
      type: :string,
      default: "v4l2:/dev/video0",
      doc: "The device that delivers depth, see `Situ.Media.Device`."
    ],
    intrinsics: [
      type: {:struct, Situ.CameraIntrinsics},
      required: true,
      doc: "The intrinsics of the depth camera, for images of the size that it delivers."
    ],
    pose: [
      type: {:optional, {:struct, Situ.Pose}},
      default: nil,
      doc: "The camera's pose; `nil` is the origin, looking along x."
    ],
    scale: [type: :number, default: 0.001, doc: "Metres per depth unit."],
    semantics: [
      type: {:in, [:plane, :point]},
      default: :plane,
      doc:
        "Whether depth is measured to the plane through the camera, or along the ray, see `Situ.DepthImage`."
    ],
    rate: [type: {:optional, :pos_integer}, default: nil, doc: "Images per second."],
    color: [
      type: {:optional, :string},
      default: nil,
      doc: "The device that delivers colour from the same viewpoint; `nil` for no colour."
    ],
    color_intrinsics: [
      type: {:optional, {:struct, Situ.CameraIntrinsics}},
      default: nil,
      doc: "The intrinsics of the colour device; `nil` uses the intrinsics of the depth camera."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Space.DepthCamera
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, Error, Image, Pose}
  alias Situ.Media.{Camera, Device}
  alias Situ.Space.DepthCamera

  @impl true
  def open(p, opts) do
    opts = opts |> Situ.Options.validate!(@schema) |> Map.new()
    pose = opts.pose || Pose.identity()
    lens = opts.intrinsics
    color_lens = opts.color_intrinsics || lens

    # Depth is not scaled: interpolation between near and far pixels would invent surfaces between them.
    depth =
      p
      |> Camera.open(
        device: opts.device,
        size: nil,
        rate: opts.rate,
        format: :gray16,
        # FFmpeg's name for V4L2's Z16
        input_format: "gray16le",
        args: size_arguments(opts.device, lens)
      )
      |> Situ.map(
        fn picture ->
          depth = picture |> ensure_size(lens) |> to_depth_image(opts) |> Error.unwrap!()
          CameraView.new(depth, lens, pose)
        end,
        name: "Depth",
        type: CameraView
      )

    %DepthCamera{depth: depth, color: opts.color && open_color(p, opts, color_lens, pose)}
  end

  # A camera may support several sizes, so the size of the intrinsics is requested.
  defp size_arguments(device, lens) do
    case Device.parse_name(device) do
      {:ok, {Device.V4L2, _}} -> ["-video_size", "#{lens.width}x#{lens.height}"]
      _ -> []
    end
  end

  defp open_color(p, opts, lens, pose) do
    p
    |> Camera.open(device: opts.color, size: {lens.width, lens.height}, rate: opts.rate)
    |> Situ.map(&CameraView.new(&1, lens, pose), name: "Color", type: CameraView)
  end

  defp ensure_size(%Image{width: w, height: h} = picture, %CameraIntrinsics{width: w, height: h}),
    do: picture

  defp ensure_size(%Image{} = picture, lens) do
    raise Error.new(
            :bad_camera,
            "the camera gives images of #{picture.width}x#{picture.height}, its intrinsics are " <>
              "for #{lens.width}x#{lens.height}",
            fix: "give the intrinsics for the size that the camera delivers"
          )
  end

  defp to_depth_image(%Image{} = picture, opts) do
    DepthImage.new(
      width: picture.width,
      height: picture.height,
      stride: picture.stride,
      data: picture.data,
      scale: opts.scale,
      semantics: opts.semantics
    )
  end
end
