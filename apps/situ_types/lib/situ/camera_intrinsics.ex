defmodule Situ.CameraIntrinsics do
  @moduledoc """
  The intrinsics of a camera: image size, focal lengths and principal point in pixels, and lens distortion.

  `radial` holds the coefficients k1 to k6 and `tangential` holds p0 and p1 of the rational distortion model
  (Brown-Conrady, as in OpenCV and \\psi). `Situ.Space.Camera` projects points with these values.

      iex> camera = Situ.CameraIntrinsics.new!(width: 640, height: 480, focal: {500, 500})
      iex> camera.principal
      {320.0, 240.0}
      iex> {:error, error} = Situ.CameraIntrinsics.new(width: 640, height: 480, focal: {0, 500})
      iex> error.code
      :bad_camera
  """
  @behaviour Situ.Codec

  alias Situ.Error

  @enforce_keys [:width, :height, :focal, :principal]
  defstruct [
    :width,
    :height,
    :focal,
    :principal,
    radial: {0.0, 0.0, 0.0, 0.0, 0.0, 0.0},
    tangential: {0.0, 0.0},
    distorts?: true
  ]

  @type t :: %__MODULE__{
          width: pos_integer(),
          height: pos_integer(),
          focal: {float(), float()},
          principal: {float(), float()},
          radial: {float(), float(), float(), float(), float(), float()},
          tangential: {float(), float()},
          distorts?: boolean()
        }

  @pair {:tuple, [:number, :number]}
  @schema [
    width: [type: :pos_integer, required: true, doc: "Image width in pixels."],
    height: [type: :pos_integer, required: true, doc: "Image height in pixels."],
    focal: [type: @pair, required: true, doc: "Focal lengths in pixels, along x and y."],
    principal: [
      type: {:optional, @pair},
      default: nil,
      doc: "Principal point in pixels; the image center by default."
    ],
    radial: [
      type: {:list, :number},
      default: [],
      doc: "Up to six coefficients k1 to k6; missing ones are 0."
    ],
    tangential: [type: @pair, default: {0.0, 0.0}, doc: "Coefficients p0 and p1."],
    distorts?: [
      type: :boolean,
      default: true,
      doc:
        "Whether the closed form maps undistorted to distorted coordinates, as in OpenCV; some devices invert it."
    ]
  ]

  @doc """
  Builds validated intrinsics.

  #{Situ.Options.docs(@schema)}
  """
  @spec new(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         opts = Map.new(opts),
         :ok <- check_optics(opts) do
      {px, py} = opts.principal || {opts.width / 2, opts.height / 2}
      {fx, fy} = opts.focal
      {p0, p1} = opts.tangential

      radial =
        (opts.radial ++ List.duplicate(0.0, 6))
        |> Enum.take(6)
        |> Enum.map(&(&1 * 1.0))
        |> List.to_tuple()

      {:ok,
       struct!(__MODULE__, %{
         opts
         | focal: {fx * 1.0, fy * 1.0},
           principal: {px * 1.0, py * 1.0},
           radial: radial,
           tangential: {p0 * 1.0, p1 * 1.0}
       })}
    end
  end

  @doc "Like `new/1`, but returns the intrinsics or raises the error."
  @spec new!(keyword()) :: t()
  def new!(opts), do: Error.unwrap!(new(opts))

  defp check_optics(%{focal: {fx, fy}}) when fx <= 0 or fy <= 0 do
    {:error,
     Error.new(:bad_camera, "invalid focal lengths #{fx} and #{fy}",
       why: "both must be positive numbers of pixels"
     )}
  end

  defp check_optics(%{radial: radial}) when length(radial) > 6,
    do:
      {:error, Error.new(:bad_camera, "#{length(radial)} radial coefficients, the model has six")}

  defp check_optics(_opts), do: :ok

  @doc """
  Returns the intrinsics for an image resized to `width` x `height`. Focal lengths and principal point are scaled;
  distortion is unchanged.

      iex> camera = Situ.CameraIntrinsics.new!(width: 640, height: 480, focal: {500, 500})
      iex> half = Situ.CameraIntrinsics.resize_to(camera, 320, 240)
      iex> {half.width, half.focal, half.principal}
      {320, {250.0, 250.0}, {160.0, 120.0}}
  """
  @spec resize_to(t(), pos_integer(), pos_integer()) :: t()
  def resize_to(%__MODULE__{focal: {fx, fy}, principal: {px, py}} = camera, width, height)
      when is_integer(width) and width > 0 and is_integer(height) and height > 0 do
    {sx, sy} = {width / camera.width, height / camera.height}

    %{
      camera
      | width: width,
        height: height,
        focal: {fx * sx, fy * sy},
        principal: {px * sx, py * sy}
    }
  end

  @doc """
  Returns the intrinsics for a cropped image. The tuple holds left edge, top edge, width and height of the crop in
  pixels.

      iex> camera = Situ.CameraIntrinsics.new!(width: 640, height: 480, focal: {500, 500})
      iex> part = Situ.CameraIntrinsics.crop_to(camera, {100, 40, 200, 100})
      iex> {part.width, part.focal, part.principal}
      {200, {500.0, 500.0}, {220.0, 200.0}}
  """
  @spec crop_to(t(), {integer(), integer(), pos_integer(), pos_integer()}) :: t()
  def crop_to(%__MODULE__{principal: {px, py}} = camera, {x, y, width, height}) do
    %{camera | width: width, height: height, principal: {px - x, py - y}}
  end

  @impl Situ.Codec
  def codec_name, do: "situ.camera_intrinsics"

  @impl Situ.Codec
  def encode(%__MODULE__{} = c) do
    numbers = Enum.flat_map([c.focal, c.principal, c.radial, c.tangential], &Tuple.to_list/1)

    head =
      <<1, if(c.distorts?, do: 1, else: 0), 0::16, c.width::little-32, c.height::little-32,
        0::32>>

    for number <- numbers, into: head, do: <<number::little-float-64>>
  end

  @impl Situ.Codec
  def decode(
        <<1, distorts, 0::16, width::little-32, height::little-32, 0::32,
          numbers::binary-size(96)>>
      )
      when distorts in [0, 1] do
    case for <<number::little-float-64 <- numbers>>, do: number do
      [fx, fy, px, py, k1, k2, k3, k4, k5, k6, p0, p1] ->
        new(
          width: width,
          height: height,
          focal: {fx, fy},
          principal: {px, py},
          radial: [k1, k2, k3, k4, k5, k6],
          tangential: {p0, p1},
          distorts?: distorts == 1
        )

      _not_finite ->
        {:error, Error.new(:bad_camera, "stored intrinsics contain a number that is not finite")}
    end
  end

  def decode(_bytes), do: {:error, Error.new(:bad_camera, "not stored camera intrinsics")}
end
