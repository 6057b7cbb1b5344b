defmodule Situ.ImageOps.Geometry do
  @moduledoc false
  # Geometric operations: crop, resize, letterbox, flip, rotate, warp and paste. `Situ.ImageOps` documents the
  # functions.
  alias Situ.{DepthImage, Error, Image, Rect}
  alias Situ.Image.{Color, Format}
  alias Situ.ImageOps.{ArgumentCheck, CostEstimate}
  alias Situ.Media.NativeKernel

  @filters [:nearest, :bilinear, :bicubic, :area, :smooth, :lanczos]
  @warp_filters [:nearest, :bilinear, :bicubic]

  @warp [
    filter: [type: {:in, @warp_filters}, default: :bilinear, doc: "Interpolation between pixels."],
    border: [
      type: {:in, [:constant, :replicate]},
      default: :constant,
      doc: "Value outside the source: `:color`, or the source's edge pixels."
    ],
    color: [
      type: :any,
      default: 0,
      doc: "Channel values in memory order, or one value for all channels, for uncovered pixels."
    ]
  ]

  @spec warp_schema() :: Situ.Options.schema()
  def warp_schema, do: @warp

  def crop(image, rect, opts \\ [])

  def crop(%DepthImage{} = depth, rect, opts),
    do: DepthImage.map_gray16(depth, &crop(&1, rect, opts))

  def crop(%Image{} = image, {x, y, w, h}, opts),
    do: crop(image, %Rect{x: x, y: y, width: w, height: h}, opts)

  def crop(%Image{} = image, %Rect{} = rect, opts) do
    with {:ok, image} <- Image.validate(image),
         {:ok, _} <-
           ArgumentCheck.check_floats([rect.x, rect.y, rect.width, rect.height], "the rectangle") do
      case crop_rect(image, rect, Keyword.validate!(opts, clip: false)[:clip]) do
        nil ->
          {:ok, nil}

        {x, y, w, h} ->
          cost = max(w, 0) * max(h, 0) * Format.bytes_per_pixel(image.format) / 8000
          NativeKernel.run_image({:crop, image, x, y, w, h}, cost)
      end
    end
  end

  defp crop_rect(_image, rect, false), do: round_rect(rect)

  defp crop_rect(image, rect, true) do
    bounds = %Rect{x: 0, y: 0, width: image.width, height: image.height}
    {x, y, w, h} = round_rect(rect)

    case Rect.intersect(bounds, %Rect{x: x, y: y, width: w, height: h}) do
      nil -> nil
      part -> round_rect(part)
    end
  end

  # Rounds both edges, so that adjacent rectangles stay adjacent.
  defp round_rect(%Rect{x: x, y: y, width: w, height: h}) do
    {left, top} = {round(x), round(y)}
    {left, top, round(x + w) - left, round(y + h) - top}
  end

  def resize(%Image{} = image, width, height, opts \\ []) do
    filter = fetch_filter!(opts, @filters)

    with {:ok, image} <- Image.validate(image),
         :ok <- check_size(width, height) do
      run_resize(image, width, height, filter)
    end
  end

  # OpenCV is the fastest for bilinear resizing, up to its maximum side. It does not weight by alpha, so formats with
  # alpha use another kernel.
  defp run_resize(%{format: format} = image, width, height, :bilinear)
       when format in [:gray8, :gray16, :bgr24, :rgb24, :bgrx32] and width <= 32_766 and
              height <= 32_766 and image.width <= 32_766 and image.height <= 32_766 do
    us = CostEstimate.resize_cost(image, width, height, :bilinear)

    case NativeKernel.run_opencv({:resize_bilinear, image, width, height}, us) do
      {:error, %{code: :opencv_missing}} ->
        NativeKernel.run_image({:resize, image, width, height, :bilinear}, us)

      result ->
        result
    end
  end

  defp run_resize(image, width, height, filter) do
    us = CostEstimate.resize_cost(image, width, height, filter)
    NativeKernel.run_image({:resize, image, width, height, filter}, us)
  end

  def scale(%Image{} = image, sx, sy, opts \\ []) do
    with {:ok, [sx, sy]} <- ArgumentCheck.check_floats([sx, sy], "a factor") do
      width = max(round(image.width * sx), 1)
      height = max(round(image.height * sy), 1)
      resize(image, width, height, opts)
    end
  end

  def letterbox(%Image{} = image, width, height, opts \\ []) do
    {color, opts} = Keyword.pop(opts, :color, 0)
    filter = fetch_filter!(opts, @filters)

    with {:ok, image} <- Image.validate(image),
         :ok <- check_size(width, height) do
      pixel = Color.pack_pixel(image.format, color)
      job = {:letterbox, image, width, height, filter, pixel}
      NativeKernel.run_image(job, CostEstimate.resize_cost(image, width, height, filter))
    end
  end

  def letterbox_rect(from_width, from_height, width, height) do
    scale = min(width / from_width, height / from_height)
    w = from_width |> Elixir.Kernel.*(scale) |> round() |> max(1) |> min(width)
    h = from_height |> Elixir.Kernel.*(scale) |> round() |> max(1) |> min(height)
    %Rect{x: div(width - w, 2), y: div(height - h, 2), width: w, height: h}
  end

  def flip(%Image{} = image, axis) when axis in [:horizontal, :vertical, :both] do
    with {:ok, image} <- Image.validate(image),
         do: NativeKernel.run_image({:flip, image, axis}, byte_size(image.data) / 2000)
  end

  def rotate(%Image{} = image, degrees, opts \\ []) do
    {fit, opts} = Keyword.pop(opts, :fit, :tight)

    with {:ok, image} <- Image.validate(image),
         {:ok, [degrees]} <- ArgumentCheck.check_floats([degrees], "degrees") do
      turns = degrees / 90

      if fit == :tight and trunc(turns) == turns do
        job = {:quarter_turns, image, Integer.mod(trunc(turns), 4)}
        NativeKernel.run_image(job, byte_size(image.data) / 500)
      else
        rotate_about_center(image, degrees, rotated_size(image, degrees, fit), opts)
      end
    end
  end

  defp rotate_about_center(image, degrees, {width, height}, opts) do
    angle = degrees * :math.pi() / 180
    {cos, sin} = {:math.cos(angle), :math.sin(angle)}
    # Rotates about the centers of the pixel grids. y points down, so the rotation is clockwise.
    {cx, cy} = {(image.width - 1) / 2, (image.height - 1) / 2}
    {ox, oy} = {(width - 1) / 2, (height - 1) / 2}

    matrix = [cos, -sin, ox - cos * cx + sin * cy, sin, cos, oy - sin * cx - cos * cy]
    warp_affine(image, matrix, [width: width, height: height] ++ opts)
  end

  defp rotated_size(image, _degrees, :same), do: {image.width, image.height}

  defp rotated_size(image, _degrees, :loose) do
    side = trunc(:math.sqrt(image.width * image.width + image.height * image.height))
    {side, side}
  end

  defp rotated_size(image, degrees, :tight) do
    angle = degrees * :math.pi() / 180
    {cos, sin} = {abs(:math.cos(angle)), abs(:math.sin(angle))}
    {w, h} = {image.width - 1, image.height - 1}
    # The small number compensates for rounding errors of integer extents.
    {trunc(w * cos + h * sin + 1 + 1.0e-9), trunc(w * sin + h * cos + 1 + 1.0e-9)}
  end

  def warp_affine(%Image{} = image, matrix, opts \\ []),
    do: warp_image(:warp_affine, image, matrix, opts)

  def warp_perspective(%Image{} = image, matrix, opts \\ []),
    do: warp_image(:warp_perspective, image, matrix, opts)

  defp warp_image(kind, image, matrix, opts) do
    {width, opts} = Keyword.pop(opts, :width, image.width)
    {height, opts} = Keyword.pop(opts, :height, image.height)

    with {:ok, opts} <- Situ.Options.validate(opts, @warp),
         {:ok, image} <- Image.validate(image),
         {:ok, matrix} <- ArgumentCheck.check_floats(matrix, "an element of the matrix"),
         :ok <- check_size(width, height) do
      edge = {opts[:filter], opts[:border], Color.to_opencv_scalar(image.format, opts[:color])}
      cost = width * height * length(Format.channels(image.format)) / 400
      NativeKernel.run_opencv({kind, image, width, height, matrix, edge}, cost)
    end
  end

  def paste(%Image{} = image, %Image{} = part, {x, y}, opts \\ []) do
    with {:ok, image} <- Image.validate(image),
         {:ok, part} <- Image.validate(part),
         {:ok, mask} <- validate_mask(opts[:mask]) do
      NativeKernel.run_image({:paste, image, part, mask, x, y}, byte_size(image.data) / 8000)
    end
  end

  defp validate_mask(nil), do: {:ok, nil}
  defp validate_mask(%Image{} = image), do: Image.validate(image)

  defp fetch_filter!(opts, known) do
    case Keyword.validate!(opts, filter: :bilinear)[:filter] do
      filter when is_atom(filter) ->
        if filter in known do
          filter
        else
          raise ArgumentError, "unknown filter #{inspect(filter)}, known: #{inspect(known)}"
        end
    end
  end

  # The native side cannot represent other sizes.
  defp check_size(width, height) do
    if is_integer(width) and is_integer(height) and width in 1..0x7FFFFFFF and
         height in 1..0x7FFFFFFF do
      :ok
    else
      what = "invalid image size: #{inspect(width)}x#{inspect(height)}"
      {:error, Error.new(:bad_size, what, fix: "use integers of 1 or more, in pixels")}
    end
  end
end
