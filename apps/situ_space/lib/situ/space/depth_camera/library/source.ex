defmodule Situ.Space.DepthCamera.Library.Source do
  @moduledoc false
  # The source of `Situ.Space.DepthCamera.Library`: views of depth and colour from the program
  # `depth_port`. It requests another image when one has been taken. If a pipeline is too slow,
  # the program drops images and counts them.
  use Situ.Component,
    outputs: [depth: Situ.CameraView, color: Situ.CameraView],
    options: [
      device: [type: :string, required: true],
      intrinsics: [type: {:optional, {:struct, Situ.CameraIntrinsics}}, default: nil],
      color_intrinsics: [type: {:optional, {:struct, Situ.CameraIntrinsics}}, default: nil],
      pose: [type: {:struct, Situ.Pose}, required: true],
      reconnect: [type: :boolean, default: true],
      stall_timeout: [type: :pos_integer, default: 10_000_000_000]
    ]

  alias Situ.{CameraIntrinsics, CameraView, DepthImage, Error, Image}
  alias Situ.Space.DepthCamera.Library.PortProgram
  require Logger

  @retry_ms 1_000
  # Two readings of the same clock differ by at most this much.
  @same_clock 1_000_000

  @enforce_keys [:opts]
  defstruct [
    :opts,
    :port,
    :name,
    :heard,
    :losing,
    lenses: %{},
    offset: 0,
    last: %{},
    lost: 0,
    over: false,
    waiting: []
  ]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(context, camera) do
    endless = if camera.opts.reconnect, do: [{:complete, :infinity}], else: []
    {endless, open_camera(camera, context)}
  end

  defp open_camera(camera, context) do
    difference = context.now - Situ.Time.now()
    offset = if abs(difference) < @same_clock, do: 0, else: difference

    case PortProgram.open(camera.opts.device) do
      {:ok, port} ->
        PortProgram.request_images(port, :first)
        schedule_watchdog(%{camera | port: port, offset: offset, heard: true})

      {:error, error} ->
        raise error
    end
  end

  # The watchdog uses the machine's time, because a pipeline's clock may be stopped or run at another speed.
  defp schedule_watchdog(camera) do
    Process.send_after(self(), {:watch, camera.port}, div(camera.opts.stall_timeout, 1_000_000))
    camera
  end

  @impl true
  def handle_info({port, {:data, packet}}, context, %{port: port} = camera),
    do: packet |> PortProgram.decode_packet() |> handle_packet(%{camera | heard: true}, context)

  def handle_info({port, {:exit_status, 0}}, _context, %{port: port} = camera),
    do: complete_streams(camera)

  def handle_info({port, {:exit_status, status}}, _context, %{port: port} = camera),
    do: handle_loss(camera, "its program ended with status #{status}")

  def handle_info({:EXIT, port, reason}, _context, %{port: port} = camera),
    do: handle_loss(camera, "its program ended: #{inspect(reason)}")

  def handle_info({:watch, port}, _context, %{port: port, heard: true} = camera),
    do: {[], schedule_watchdog(%{camera | heard: false})}

  def handle_info({:watch, port}, _context, %{port: port} = camera),
    do: handle_loss(camera, "it sent nothing for #{div(camera.opts.stall_timeout, 1_000_000)} ms")

  def handle_info(:reconnect, context, %{port: nil} = camera),
    do: {[], open_camera(camera, context)}

  def handle_info(_other, _context, camera), do: {[], camera}

  defp handle_packet({:camera, name, lenses}, camera, _context) do
    if camera.losing, do: Logger.info("#{camera.opts.device} is back")
    camera = %{camera | name: name, losing: nil, lenses: resolve_lenses!(lenses, camera.opts)}
    # A camera without colour will never send a colour image.
    {if(lenses.color, do: [], else: [{:close, :color}]), camera}
  end

  defp handle_packet({:picture, kind, time, lost, size, pixels}, camera, _context) do
    lens = check_size!(camera.lenses[kind], size, kind)
    time = max(time + camera.offset, Map.get(camera.last, kind, time + camera.offset - 1) + 1)
    view = CameraView.new(build_image(kind, size, pixels), lens, camera.opts.pose)

    {[],
     %{
       camera
       | last: Map.put(camera.last, kind, time),
         lost: camera.lost + lost,
         waiting: camera.waiting ++ [{kind, time, view}]
     }}
  end

  defp handle_packet({:failed, why}, camera, _context), do: handle_loss(camera, why)
  defp handle_packet(:over, camera, _context), do: complete_streams(camera)

  defp handle_packet(:error, camera, _context),
    do: handle_loss(camera, "its program sent an invalid packet")

  defp build_image(:depth, {width, height}, pixels) do
    [
      width: width,
      height: height,
      stride: width * 2,
      data: pixels,
      scale: 0.001,
      semantics: :plane
    ]
    |> DepthImage.new()
    |> Error.unwrap!()
  end

  defp build_image(:color, {width, height}, pixels),
    do: %Image{format: :rgb24, width: width, height: height, stride: width * 3, data: pixels}

  @impl true
  def handle_demand(n, _context, camera) do
    {taken, waiting} = Enum.split(camera.waiting, n)

    if camera.port,
      do: Enum.each(taken, fn {kind, _, _} -> PortProgram.request_images(camera.port, kind) end)

    camera = %{camera | waiting: waiting}

    if camera.over do
      {last, camera} = complete_streams(camera)
      {taken ++ last, camera}
    else
      {taken, camera}
    end
  end

  # A camera that has delivered data is expected to come back. One that was never found is an error.
  defp handle_loss(camera, why) do
    camera = close_camera(camera)

    if camera.opts.reconnect and camera.name != nil do
      unless camera.losing,
        do: Logger.warning("#{camera.opts.device} is lost, trying again every second: #{why}")

      Process.send_after(self(), :reconnect, @retry_ms)
      {[], %{camera | losing: why}}
    else
      raise Error.new(:no_camera, "#{camera.opts.device} delivers no images",
              why: why,
              fix: "`situ devices` lists the connected cameras"
            )
    end
  end

  # Images that have already arrived are emitted first.
  defp complete_streams(%{waiting: []} = camera) do
    times = Map.values(camera.last)
    {[{:complete, Enum.max(times, fn -> 0 end)}], %{close_camera(camera) | over: false}}
  end

  defp complete_streams(camera), do: {[], %{close_camera(camera) | over: true}}

  @impl true
  def handle_stop(_final_time, _context, camera), do: {[], close_camera(camera)}

  @impl true
  def terminate(_reason, camera), do: close_camera(camera)

  defp close_camera(%{port: nil} = camera), do: camera

  defp close_camera(camera) do
    PortProgram.close(camera.port)
    %{camera | port: nil}
  end

  @impl true
  def describe(camera) do
    state = if camera.port, do: "running", else: "not connected"

    "#{camera.opts.device} (#{camera.name || "not opened yet"}): #{state}, #{camera.lost} images lost"
  end

  defp resolve_lenses!(told, opts) do
    depth = opts.intrinsics || ensure_lens!(told.depth, opts)

    color =
      opts.color_intrinsics ||
        if(match?(%CameraIntrinsics{}, told.color), do: told.color, else: depth)

    %{depth: depth, color: color}
  end

  defp ensure_lens!(%CameraIntrinsics{} = lens, _opts), do: lens

  defp ensure_lens!(_size, opts) do
    raise Error.new(:no_intrinsics, "#{opts.device} does not report its intrinsics",
            fix: "set `intrinsics:` for images of the size that the camera delivers"
          )
  end

  defp check_size!(%CameraIntrinsics{width: w, height: h} = lens, {w, h}, _kind), do: lens

  defp check_size!(lens, {width, height}, kind) do
    raise Error.new(
            :bad_camera,
            "the camera gives images of #{width}x#{height}, the intrinsics of its #{kind} are " <>
              "for #{lens.width}x#{lens.height}",
            fix: "give the intrinsics for the size that the camera delivers"
          )
  end
end
