defmodule Situ.ImageOps.Geometry do
  @moduledoc false
  # Geometric operations: crop, resize, letterbox, flip, rotate, warp and paste. Call these
  # functions through `Situ.ImageOps`.
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

  @doc """
  Returns the part inside `rect` (a `Situ.Rect` or `{x, y, width, height}`; fractions are rounded to complete pixels).

  A rectangle that is not inside the image is an error. With `clip: true` it is clipped to the image first, and the
  result is `{:ok, nil}` if nothing is left.

      iex> image = Situ.Image.new!(width: 3, height: 2, format: :gray8, data: <<1, 2, 3, 4, 5, 6>>)
      iex> {:ok, part} = Situ.ImageOps.crop(image, {1, 0, 2, 2})
      iex> part.data
      <<2, 3, 5, 6>>
      iex> {:error, error} = Situ.ImageOps.crop(image, {2, 0, 2, 2})
      iex> error.code
      :bad_rect
      iex> Situ.ImageOps.crop(image, {5, 5, 1, 1}, clip: true)
      {:ok, nil}

  A depth image is cropped to a depth image of the same semantics and scale.
  """
  @spec crop(
          Image.t() | DepthImage.t(),
          Rect.t() | {number(), number(), number(), number()},
          keyword()
        ) :: {:ok, Image.t() | DepthImage.t() | nil} | {:error, Error.t()}
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

  @doc """
  Resizes an image to exactly `width` by `height` pixels, in the same format.

  `filter:` is `:bilinear` (default; two by two pixels, OpenCV's INTER_LINEAR), `:nearest`, `:bicubic`, `:area`
  (mean of the covered pixels), `:smooth` (bilinear over all covered pixels, which shrinks without jagged edges) or
  `:lanczos`. Filters that overshoot (`:bicubic`, `:lanczos`) are clipped at 0 and 255 after each of their two passes,
  as in Pillow. At hard edges they differ from OpenCV, which clips once.

      iex> {:ok, small} = Situ.ImageOps.resize(Situ.Image.new_filled(64, 48, :bgr24, [1, 2, 3]), 32, 24)
      iex> {small, Situ.Image.fetch_pixel(small, 31, 23)}
      {small, {:ok, [1, 2, 3]}}
  """
  @spec resize(Image.t(), pos_integer(), pos_integer(), keyword()) :: Image.result()
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

  @doc """
  Resizes an image by factors. Sizes are rounded to the nearest pixel and are at least 1.

      iex> {:ok, image} = Situ.ImageOps.scale(Situ.Image.new_filled(10, 10, :gray8), 0.5, 2)
      iex> {image.width, image.height}
      {5, 20}
  """
  @spec scale(Image.t(), number(), number(), keyword()) :: Image.result()
  def scale(%Image{} = image, sx, sy, opts \\ []) do
    with {:ok, [sx, sy]} <- ArgumentCheck.check_floats([sx, sy], "a factor") do
      width = max(round(image.width * sx), 1)
      height = max(round(image.height * sy), 1)
      resize(image, width, height, opts)
    end
  end

  @doc """
  Resizes an image to the largest size of the same proportions that fits `width` by `height`, centered, and fills the
  rest with `color:` (default 0). `letterbox_rect/4` returns its position.

      iex> {:ok, image} = Situ.ImageOps.letterbox(Situ.Image.new_filled(4, 2, :gray8, 9), 4, 4)
      iex> image.data
      <<0, 0, 0, 0, 9, 9, 9, 9, 9, 9, 9, 9, 0, 0, 0, 0>>
  """
  @spec letterbox(Image.t(), pos_integer(), pos_integer(), keyword()) :: Image.result()
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

  @doc """
  Returns the rectangle of a `from_width` x `from_height` image in its `width` x `height` letterbox.

      iex> Situ.ImageOps.letterbox_rect(1280, 720, 640, 640)
      %Situ.Rect{x: 0, y: 140, width: 640, height: 360}
  """
  @spec letterbox_rect(pos_integer(), pos_integer(), pos_integer(), pos_integer()) :: Rect.t()
  def letterbox_rect(from_width, from_height, width, height) do
    scale = min(width / from_width, height / from_height)
    w = from_width |> Elixir.Kernel.*(scale) |> round() |> max(1) |> min(width)
    h = from_height |> Elixir.Kernel.*(scale) |> round() |> max(1) |> min(height)
    %Rect{x: div(width - w, 2), y: div(height - h, 2), width: w, height: h}
  end

  @doc """
  Mirrors an image: `:horizontal` along the horizontal axis (top becomes bottom), `:vertical` along the vertical axis
  (left becomes right), or `:both`.

      iex> image = Situ.Image.new!(width: 2, height: 2, format: :gray8, data: <<1, 2, 3, 4>>)
      iex> for axis <- [:horizontal, :vertical, :both], do: Situ.ImageOps.flip!(image, axis).data
      [<<3, 4, 1, 2>>, <<2, 1, 4, 3>>, <<4, 3, 2, 1>>]
  """
  @spec flip(Image.t(), :horizontal | :vertical | :both) :: Image.result()
  def flip(%Image{} = image, axis) when axis in [:horizontal, :vertical, :both] do
    with {:ok, image} <- Image.validate(image),
         do: NativeKernel.run_image({:flip, image, axis}, byte_size(image.data) / 2000)
  end

  @doc """
  Rotates an image clockwise about its center by `degrees`.

  Multiples of 90 are exact with `fit: :tight`. For other angles pixels are interpolated (`filter:`, `color:`,
  `border:`). `fit:` sets the size of the result: `:tight` (default) is the extent of the rotated corners, `:loose` is a
  square with the side of the diagonal at any angle, and `:same` is the size of the source.

      iex> image = Situ.Image.new_filled(100, 200, :gray8)
      iex> {:ok, tight} = Situ.ImageOps.rotate(image, 10)
      iex> {:ok, loose} = Situ.ImageOps.rotate(image, 10, fit: :loose)
      iex> {tight.width, tight.height, loose.width, loose.height}
      {133, 214, 223, 223}
  """
  @spec rotate(Image.t(), number(), keyword()) :: Image.result()
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

  @doc """
  Transforms an image by a 2x3 matrix `[a, b, tx, c, d, ty]` that maps a source pixel `{x, y}` to
  `{a x + b y + tx, c x + d y + ty}` (OpenCV's warpAffine). `width:` and `height:` of the result default to the source's
  size.

  #{Situ.Options.docs(@warp)}

      iex> image = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<5, 7>>)
      iex> Situ.ImageOps.warp_affine!(image, [1, 0, 1, 0, 1, 0]).data
      <<0, 5>>
  """
  @spec warp_affine(Image.t(), [number()], keyword()) :: Image.result()
  def warp_affine(%Image{} = image, matrix, opts \\ []),
    do: warp_image(:warp_affine, image, matrix, opts)

  @doc """
  Transforms an image like `warp_affine/3`, but by a 3x3 matrix (nine numbers) in homogeneous coordinates.

      iex> image = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<5, 7>>)
      iex> Situ.ImageOps.warp_perspective!(image, [1, 0, 1, 0, 1, 0, 0, 0, 1]).data
      <<0, 5>>
  """
  @spec warp_perspective(Image.t(), [number()], keyword()) :: Image.result()
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

  @doc """
  Copies `part` over `image` with its top left corner at `{x, y}` and clips parts outside the image. Both need the same
  format. With `mask:`, a `:gray8` image of the size of `part`, only pixels where the mask is not 0 are copied.

      iex> image = Situ.Image.new_filled(3, 1, :gray8, 1)
      iex> {:ok, pasted} = Situ.ImageOps.paste(image, Situ.Image.new_filled(2, 1, :gray8, 8), {2, 0})
      iex> pasted.data
      <<1, 1, 8>>
  """
  @spec paste(Image.t(), Image.t(), {integer(), integer()}, keyword()) :: Image.result()
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
