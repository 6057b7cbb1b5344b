defmodule Situ.DepthImage do
  @moduledoc """
  An image of distances, with 16 bits per pixel, little-endian. Each value times `scale` is a distance in metres; 0
  means unknown.

  `semantics` defines the measured distance: `:plane` is the distance to the plane through the camera (the usual z),
  and `:point` is the length of the ray.

      iex> {:ok, depth} = Situ.DepthImage.new(width: 2, height: 1, data: <<500::little-16, 1500::little-16>>)
      iex> depth
      #Situ.DepthImage<2x1, 0.001 m a unit, :plane>
      iex> Situ.DepthImage.fetch_distance(depth, 1, 0)
      {:ok, 1.5}
  """
  @behaviour Situ.Codec

  alias Situ.{Error, Image}

  @enforce_keys [:width, :height, :stride, :data]
  defstruct [:width, :height, :stride, :data, semantics: :plane, scale: 0.001]

  @type t :: %__MODULE__{
          width: pos_integer(),
          height: pos_integer(),
          stride: pos_integer(),
          data: binary(),
          semantics: :plane | :point,
          scale: float()
        }
  @type result :: {:ok, t()} | {:error, Error.t()}

  @schema [
    width: [type: :pos_integer, required: true, doc: "Width in pixels."],
    height: [type: :pos_integer, required: true, doc: "Height in pixels."],
    stride: [type: {:optional, :pos_integer}, default: nil, doc: "Bytes from row to row."],
    data: [type: :string, required: true, doc: "16-bit little-endian values."],
    semantics: [
      type: {:in, [:plane, :point]},
      default: :plane,
      doc: "`:plane`: distance to the plane through the camera (z); `:point`: length of the ray."
    ],
    scale: [type: :number, default: 0.001, doc: "Metres per unit."]
  ]

  @doc """
  Builds a validated depth image without copying `data`.

  #{Situ.Options.docs(@schema)}
  """
  @spec new(keyword()) :: result()
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      opts = Map.new(opts)

      validate(
        struct!(__MODULE__, %{
          opts
          | stride: opts.stride || opts.width * 2,
            scale: opts.scale * 1.0
        })
      )
    end
  end

  @doc "Like `new/1`, but returns the image or raises the error."
  @spec new!(keyword()) :: t()
  def new!(opts), do: Situ.Error.unwrap!(new(opts))

  @doc "Validates a struct that was built by hand."
  @spec validate(t()) :: result()
  def validate(%__MODULE__{semantics: semantics, scale: scale} = depth) do
    cond do
      semantics not in [:plane, :point] ->
        {:error, Error.new(:bad_image, "unknown depth semantics #{inspect(semantics)}")}

      not (is_float(scale) and scale > 0) ->
        {:error, Error.new(:bad_image, "depth scale #{inspect(scale)} is not a positive float")}

      true ->
        with {:ok, _} <- Image.validate(to_gray16(depth)), do: {:ok, depth}
    end
  end

  @doc "Returns a `:gray16` image that shares the memory of the depth image."
  @spec to_gray16(t()) :: Image.t()
  def to_gray16(%__MODULE__{} = d) do
    %Image{width: d.width, height: d.height, stride: d.stride, format: :gray16, data: d.data}
  end

  @doc "Interprets a `:gray16` image as a depth image without copying it."
  @spec from_gray16(Image.t(), keyword()) :: result()
  def from_gray16(image, opts \\ [])

  def from_gray16(%Image{format: :gray16} = image, opts) do
    new(
      [width: image.width, height: image.height, stride: image.stride, data: image.data] ++
        Keyword.take(opts, [:semantics, :scale])
    )
  end

  def from_gray16(%Image{} = image, _opts) do
    {:error, Error.new(:bad_format, "expected a :gray16 image, got #{Image.describe(image)}")}
  end

  @doc """
  Applies an image function (crop, resize, flip, rotate ...) to the depth values and returns the result as a depth
  image. Interpolation would mix unknown values (0) into their neighbours, so resize with `filter: :nearest`.

      iex> depth = Situ.DepthImage.new!(width: 2, height: 1, data: <<1, 0, 2, 0>>, scale: 0.01)
      iex> {:ok, part} = Situ.DepthImage.map_gray16(depth, &Situ.Image.put_pixel(&1, 0, 0, 9))
      iex> {part.data, part.scale}
      {<<9, 0, 2, 0>>, 0.01}
  """
  @spec map_gray16(t(), (Image.t() -> Image.result() | {:ok, nil})) :: result() | {:ok, nil}
  def map_gray16(%__MODULE__{} = depth, fun) when is_function(fun, 1) do
    with {:ok, depth} <- validate(depth),
         {:ok, %Image{} = image} <- fun.(to_gray16(depth)),
         do: from_gray16(image, semantics: depth.semantics, scale: depth.scale)
  end

  @doc "Returns the distance in metres at a pixel, or `{:ok, nil}` if it is unknown (0)."
  @spec fetch_distance(t(), integer(), integer()) :: {:ok, float() | nil} | {:error, Error.t()}
  def fetch_distance(%__MODULE__{} = depth, x, y) do
    case Image.fetch_pixel(to_gray16(depth), x, y) do
      {:ok, [0]} -> {:ok, nil}
      {:ok, [value]} -> {:ok, value * depth.scale}
      {:error, _} = error -> error
    end
  end

  @doc """
  Returns the distance in metres at a pixel. If it is unknown (`invalid:`, default 0), the distance is interpolated
  from the nearest known values to the left, right, above and below, weighted by inverse distance. Returns
  `{:ok, nil}` if all values in these directions are unknown.

      iex> depth = Situ.DepthImage.new!(width: 4, height: 1, data: <<100, 0, 0, 0, 0, 0, 160, 0>>, scale: 0.01)
      iex> {:ok, metres} = Situ.DepthImage.interpolated_distance(depth, 1, 0)
      iex> Float.round(metres, 6)
      1.2
      iex> Situ.DepthImage.interpolated_distance(Situ.DepthImage.new!(width: 1, height: 1, data: <<0, 0>>), 0, 0)
      {:ok, nil}
  """
  @spec interpolated_distance(t(), integer(), integer(), keyword()) ::
          {:ok, float() | nil} | {:error, Error.t()}
  def interpolated_distance(%__MODULE__{} = depth, x, y, opts \\ []) do
    invalid = Keyword.get(opts, :invalid, 0)

    with {:ok, [value]} <- Image.fetch_pixel(to_gray16(depth), x, y) do
      if value == invalid,
        do: {:ok, mean_around(depth, x, y, invalid)},
        else: {:ok, value * depth.scale}
    end
  end

  defp mean_around(depth, x, y, invalid) do
    found =
      for {dx, dy} <- [{-1, 0}, {1, 0}, {0, -1}, {0, 1}],
          {value, offset} <- [nearest_known(depth, x, y, {dx, dy}, invalid)],
          value != nil,
          do: {value, 1 / offset}

    case found do
      [] ->
        nil

      found ->
        weights = found |> Enum.map(&elem(&1, 1)) |> Enum.sum()
        sum = found |> Enum.map(fn {value, weight} -> value * weight end) |> Enum.sum()
        sum / weights * depth.scale
    end
  end

  defp nearest_known(depth, x, y, {dx, dy}, invalid) do
    1
    |> Stream.iterate(&(&1 + 1))
    |> Enum.find_value(fn n ->
      case Image.fetch_pixel(to_gray16(depth), x + n * dx, y + n * dy) do
        {:ok, [^invalid]} -> nil
        {:ok, [value]} -> {value, n}
        {:error, _} -> {nil, n}
      end
    end)
  end

  @header_bytes 64

  @impl Situ.Codec
  def codec_name, do: "situ.depth_image"

  @impl Situ.Codec
  def encode(%__MODULE__{} = d) do
    semantics = if d.semantics == :plane, do: 0, else: 1

    [
      <<1, semantics, 0::16, d.width::little-32, d.height::little-32, d.stride::little-32,
        d.scale::little-float-64, 0::size((@header_bytes - 24) * 8)>>,
      d.data
    ]
  end

  @impl Situ.Codec
  def decode(
        <<1, semantics, _::16, width::little-32, height::little-32, stride::little-32,
          scale::little-float-64, _::binary-size(@header_bytes - 24), data::binary>>
      ) do
    validate(%__MODULE__{
      width: width,
      height: height,
      stride: stride,
      scale: scale,
      semantics: if(semantics == 0, do: :plane, else: :point),
      data: data
    })
  end

  def decode(_), do: {:error, Error.new(:bad_image, "not a stored depth image")}

  defimpl Inspect do
    def inspect(d, _opts) do
      "#Situ.DepthImage<#{inspect(d.width)}x#{inspect(d.height)}, #{inspect(d.scale)} m a unit, " <>
        "#{inspect(d.semantics)}>"
    end
  end
end
