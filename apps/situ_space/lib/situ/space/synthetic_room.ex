defmodule Situ.Space.SyntheticRoom do
  @moduledoc """
  A rendered room, seen by a depth camera, with two people, furniture and a floating ball. Everything is known exactly
  and is the same on every run. Use it to try things without hardware, and to compare results with the ground truth.

      camera = Situ.Space.DepthCamera.open(p, {Situ.Space.SyntheticRoom, seconds: 10})
      Situ.each(camera.depth, fn view -> IO.inspect(view.viewed) end)

  The streams other than `depth` and `color` (both `Situ.CameraView`s) are in `others`:

    * `bodies`: a list of `Situ.Skeleton`, ids 0 and 1
    * `pointing`: the `Situ.Ray3` along which person 1 points at the ball
    * `ball`: the position of the ball, a `Situ.Point3`
    * `imu`: `Situ.ImuReading`s of a sensor in the camera
    * `sound`: `Situ.AudioBuffer`s, mono, 16 bits
    * `speaking`: a map from each person's id to whether that person is speaking

  Depth is exact to one millimetre, the unit of its 16 bits, and 0 beyond their range.
  """

  alias Situ.{AudioBuffer, AudioFormat, CameraIntrinsics, CameraView, DepthImage, Image, Skeleton}
  alias Situ.Space.{DepthCamera, NativeCall, RayTable}
  alias Situ.Space.SyntheticRoom.{Scene, Voice}

  @schema [
    width: [type: :pos_integer, default: 640, doc: "The width of the images, pixels."],
    height: [type: :pos_integer, default: 480, doc: "The height of the images, pixels."],
    rate: [type: :pos_integer, default: 30, doc: "Images per second."],
    seconds: [type: {:optional, :number}, default: nil, doc: "The duration; `nil` for no end."],
    sway: [
      type: :number,
      default: 0.03,
      doc: "How far the camera moves around its position, metres and radians; 0 keeps it still."
    ],
    speech: [
      type: {:optional, {:list, :any}},
      default: nil,
      doc: "When each person speaks: `{0 or 1, from, to}` in seconds; by default they take turns."
    ],
    imu_rate: [
      type: :pos_integer,
      default: 100,
      doc: "Readings of the inertial sensor per second."
    ],
    sound_rate: [type: :pos_integer, default: 16_000, doc: "Audio samples per second."]
  ]

  use Situ.Component,
    outputs: [
      depth: CameraView,
      color: CameraView,
      bodies: {:list, Skeleton},
      pointing: Situ.Ray3,
      ball: Situ.Point3,
      imu: Situ.ImuReading,
      sound: AudioBuffer,
      speaking: {:map, :any, :boolean}
    ],
    options: @schema

  @behaviour DepthCamera

  @second 1_000_000_000
  @scale 0.001

  @impl DepthCamera
  def open(p, opts) do
    {depth, others} = p |> Situ.source(__MODULE__, opts) |> Map.pop!(:depth)
    {color, others} = Map.pop!(others, :color)
    %DepthCamera{depth: depth, color: color, others: others}
  end

  @doc "Returns the intrinsics of a camera with images of this size: 62 degrees wide, without distortion."
  @spec camera_intrinsics(pos_integer(), pos_integer()) :: CameraIntrinsics.t()
  def camera_intrinsics(width, height) do
    focal = width * 525 / 640
    CameraIntrinsics.new!(width: width, height: height, focal: {focal, focal})
  end

  @impl Situ.Component
  def init(opts) do
    intrinsics = camera_intrinsics(opts[:width], opts[:height])

    with {:ok, table} <- RayTable.new(intrinsics) do
      {:ok,
       %{opts: Map.new(opts), intrinsics: intrinsics, table: table, frame: 0, start: 0, till: nil}}
    end
  end

  @impl Situ.Component
  def handle_start(context, state) do
    own = state.opts.seconds && context.start_time + round(state.opts.seconds * @second)
    till = [own, context.replay_end] |> Enum.filter(&is_integer/1) |> Enum.min(fn -> nil end)
    state = %{state | start: context.start_time, till: till}
    {if(till, do: [], else: [{:complete, :infinity}]), state}
  end

  @impl Situ.Component
  def handle_demand(_n, _context, %{frame: :done} = state), do: {[], state}

  def handle_demand(_n, _context, %{frame: frame, opts: opts, start: start, till: till} = state) do
    time = start + div(frame * @second, opts.rate)

    if till && time >= till do
      last = start + div((frame - 1) * @second, opts.rate)
      {[{:complete, max(last, start)}], %{state | frame: :done}}
    else
      {frame_actions(frame, time, state), %{state | frame: frame + 1}}
    end
  end

  # Returns this image, and the other messages since the last image.
  defp frame_actions(frame, time, %{opts: opts} = state) do
    scene = Scene.state_at(frame / opts.rate, opts.speech, opts.sway)
    {depth, color} = render_views!(scene, state)
    {x, y, z} = scene.ball

    [
      {:depth, time, depth},
      {:color, time, color},
      {:bodies, time, scene.bodies},
      {:pointing, time, Scene.pointing_ray(scene)},
      {:ball, time, Situ.Point3.new(x, y, z)},
      {:speaking, time, Map.new(scene.people, &{&1.id, &1.speaking})}
    ] ++ imu_actions(frame, state) ++ audio_actions(frame, state)
  end

  @doc "Renders the depth and the colour image of a scene, each as a `Situ.CameraView`."
  @spec render_views(Scene.t(), CameraIntrinsics.t(), RayTable.t()) ::
          {:ok, {CameraView.t(DepthImage.t()), CameraView.t(Image.t())}}
          | {:error, Situ.Error.t()}
  def render_views(%Scene{camera: pose} = scene, intrinsics, table) do
    rotation = Situ.Quaternion.to_matrix(pose.rotation)
    arguments = [Scene.list_shapes(scene), pose.position, rotation, table.rays, @scale]
    size = [width: table.width, height: table.height]

    with {:ok, {values, pixels}} <- NativeCall.call_native(:render, arguments),
         {:ok, depth} <- DepthImage.new([data: values, scale: @scale] ++ size),
         {:ok, color} <- Image.new([data: pixels, format: :rgb24] ++ size) do
      {:ok, {CameraView.new(depth, intrinsics, pose), CameraView.new(color, intrinsics, pose)}}
    end
  end

  defp render_views!(scene, state),
    do: scene |> render_views(state.intrinsics, state.table) |> Situ.Error.unwrap!()

  defp imu_actions(frame, %{opts: opts, start: start}) do
    for n <- sample_range(frame, opts.imu_rate, opts.rate),
        do:
          {:imu, start + div(n * @second, opts.imu_rate),
           Scene.imu_reading(n / opts.imu_rate, opts.sway)}
  end

  # Returns the audio between the last image and this one. Before the first image there is no audio.
  defp audio_actions(0, _state), do: []

  defp audio_actions(frame, %{opts: opts, start: start}) do
    numbers = sample_range(frame, opts.sound_rate, opts.rate)
    speaks? = &Scene.speaking?(&1, &2, opts.speech)
    samples = Voice.generate_samples(numbers, opts.sound_rate, speaks?)
    time = start + div((numbers.last + 1) * @second, opts.sound_rate)
    [{:sound, time, AudioBuffer.from_samples(samples, AudioFormat.pcm(opts.sound_rate))}]
  end

  # Returns the sample numbers of a stream with `rate` messages per second, after the last image and until this one.
  defp sample_range(0, _rate, _pictures), do: 0..0

  defp sample_range(frame, rate, pictures),
    do: (div((frame - 1) * rate, pictures) + 1)..div(frame * rate, pictures)//1
end
