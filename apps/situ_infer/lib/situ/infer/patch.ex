defmodule Situ.Infer.Patch do
  @moduledoc false
  # A square of an image, rotated and scaled as a network's input: the affine map from patch
  # pixels to image pixels.
  #
  # `cut_tensor/4` samples it (bilinear; black outside the image) directly into an input tensor
  # `{1, size, size, 3}`, RGB. `to_image_point/2` maps the network's results back to the image.

  alias Situ.{Error, Image, Tensor}

  @enforce_keys [:size, :matrix]
  defstruct [:size, :matrix]

  @typedoc "With `matrix` `{a, b, c, d, e, f}`, patch `(x, y)` maps to image `(a x + b y + c, d x + e y + f)`."
  @type t :: %__MODULE__{
          size: pos_integer(),
          matrix: {float(), float(), float(), float(), float(), float()}
        }
  @type point :: {float(), float()}

  @doc """
  Returns the patch with the middle `center` and sides of `side` image pixels, rotated by `angle` radians (clockwise on
  the screen), sampled as `size` by `size` pixels.

      iex> patch = Situ.Infer.Patch.centered_at({100.0, 50.0}, 64.0, 0.0, 32)
      iex> Situ.Infer.Patch.to_image_point(patch, {16.0, 16.0})
      {100.0, 50.0}
      iex> Situ.Infer.Patch.to_image_point(patch, {0.0, 0.0})
      {68.0, 18.0}
  """
  @spec centered_at(point(), float(), float(), pos_integer()) :: t()
  def centered_at({cx, cy}, side, angle, size) do
    k = side / size
    {cos, sin} = {k * :math.cos(angle), k * :math.sin(angle)}
    half = size / 2
    c = cx - cos * half + sin * half
    f = cy - sin * half - cos * half
    %__MODULE__{size: size, matrix: {cos, -sin, c, sin, cos, f}}
  end

  @doc """
  Returns the unrotated square of this side with its corner at `{x, y}`. Pixel *areas* correspond, as when a crop is
  resized; `centered_at/4` instead maps pixel centres to integer positions, as `warpAffine` does.

      iex> Situ.Infer.Patch.from_square({0.0, 0.0}, 256.0, 128).matrix
      {2.0, 0.0, 0.5, 0.0, 2.0, 0.5}
  """
  @spec from_square(point(), float(), pos_integer()) :: t()
  def from_square({x, y}, side, size) do
    k = side / size
    shift = 0.5 * k - 0.5
    %__MODULE__{size: size, matrix: {k, 0.0, x + shift, 0.0, k, y + shift}}
  end

  @doc "Converts a position in the patch to a position in the image."
  @spec to_image_point(t(), point()) :: point()
  def to_image_point(%__MODULE__{matrix: {a, b, c, d, e, f}}, {x, y}),
    do: {a * x + b * y + c, d * x + e * y + f}

  @doc """
  Samples the patch; a channel value `v` (0..255) becomes `v * scale + offset`.

  The image must have an 8-bit format (grey becomes three equal channels). Errors: `:bad_image`.
  """
  @spec cut_tensor(t(), Image.t(), float(), float()) :: {:ok, Tensor.t()} | {:error, Error.t()}
  def cut_tensor(%__MODULE__{size: size} = patch, %Image{} = image, scale, offset) do
    cut_affine(image, patch.matrix, {size, size}, scale, offset)
  end

  @doc """
  Samples any affine map from patch to image pixels (a `matrix` as in `t:t/0`) at any size, into a tensor
  `{1, height, width, 3}`.
  """
  @spec cut_affine(Image.t(), tuple(), {pos_integer(), pos_integer()}, float(), float()) ::
          {:ok, Tensor.t()} | {:error, Error.t()}
  def cut_affine(%Image{} = image, matrix, {width, height} = size, scale, offset) do
    shape = {image.width, image.height, image.stride, Atom.to_string(image.format)}

    case Situ.Infer.Native.cut_patch(image.data, shape, matrix, size, {scale, offset}) do
      {:ok, data} ->
        {:ok, Tensor.new(data, :f32, {1, height, width, 3})}

      :error ->
        {:error, bad_image(image, Image.validate(image))}
    end
  end

  @doc "Samples the whole image, stretched to a size, into a tensor `{1, height, width, 3}`."
  @spec cut_whole(Image.t(), {pos_integer(), pos_integer()}, float(), float()) ::
          {:ok, Tensor.t()} | {:error, Error.t()}
  def cut_whole(%Image{width: w, height: h} = image, {width, height} = size, scale, offset) do
    {kx, ky} = {w / width, h / height}
    matrix = {kx, 0.0, 0.5 * kx - 0.5, 0.0, ky, 0.5 * ky - 0.5}
    cut_affine(image, matrix, size, scale, offset)
  end

  defp bad_image(image, {:ok, _}) do
    Error.new(:bad_image, "cannot cut from #{inspect(image)}",
      why: "models take images of an 8-bit format",
      fix: "convert it first with Situ.Image"
    )
  end

  defp bad_image(image, {:error, error}) do
    Error.new(:bad_image, "cannot cut from #{inspect(image)}",
      why: error.what,
      fix: "check the code that builds the image; Situ.Image.new/1 rejects incomplete ones"
    )
  end
end
