defmodule Situ.DepthImage do
  @moduledoc """
  A picture of distances: 16 bits a pixel, little-endian, each times `scale` metres. 0 means not known.

  `semantics` says what was measured: `:plane`, the distance to the plane through the camera (the usual z), or `:point`,
  the length of the ray.

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
    width: [type: :pos_integer, required: true, doc: "Pixels in a row."],
    height: [type: :pos_integer, required: true, doc: "Rows."],
    stride: [type: {:optional, :pos_integer}, default: nil, doc: "Bytes from row to row."],
    data: [type: :string, required: true, doc: "16-bit little-endian values."],
    semantics: [
      type: {:in, [:plane, :point]},
      default: :plane,
      doc: "`:plane`: distance to the plane through the camera (z); `:point`: length of the ray."
    ],
    scale: [type: :number, default: 0.001, doc: "Metres for a value of 1."]
  ]

  @doc """
  A checked depth image; nothing is copied.

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

  @doc "As `new/1`, but returns the image or raises the error."
  @spec new!(keyword()) :: t()
  def new!(opts), do: Situ.Error.unwrap!(new(opts))

  @doc "Checks a struct built by hand."
  @spec validate(t()) :: result()
  def validate(%__MODULE__{semantics: semantics, scale: scale} = depth) do
    cond do
      semantics not in [:plane, :point] ->
        {:error, Error.new(:bad_image, "unknown depth semantics #{inspect(semantics)}")}

      not (is_float(scale) and scale > 0) ->
        {:error, Error.new(:bad_image, "a depth scale of #{inspect(scale)} m is impossible")}

      true ->
        with {:ok, _} <- Image.validate(to_gray16(depth)), do: {:ok, depth}
    end
  end

  @doc "The same memory as a `:gray16` picture."
  @spec to_gray16(t()) :: Image.t()
  def to_gray16(%__MODULE__{} = d) do
    %Image{width: d.width, height: d.height, stride: d.stride, format: :gray16, data: d.data}
  end

  @doc "A `:gray16` picture read as depth; no copy."
  @spec from_gray16(Image.t(), keyword()) :: result()
  def from_gray16(image, opts \\ [])

  def from_gray16(%Image{format: :gray16} = image, opts) do
    new(
      [width: image.width, height: image.height, stride: image.stride, data: image.data] ++
        Keyword.take(opts, [:semantics, :scale])
    )
  end

  def from_gray16(%Image{} = image, _opts) do
    {:error, Error.new(:bad_format, "depth is :gray16, this is #{Image.describe(image)}")}
  end

  @doc """
  The depth image that a function on pictures makes of this one: crop, resize, flip, rotate ... Interpolating
  across unknown values (0) mixes them in, so resize with `filter: :nearest`.

      iex> depth = Situ.DepthImage.new!(width: 2, height: 1, data: <<1, 0, 2, 0>>, scale: 0.01)
      iex> {:ok, part} = Situ.DepthImage.through(depth, &Situ.Image.put_pixel(&1, 0, 0, 9))
      iex> {part.data, part.scale}
      {<<9, 0, 2, 0>>, 0.01}
  """
  @spec through(t(), (Image.t() -> Image.result() | {:ok, nil})) :: result() | {:ok, nil}
  def through(%__MODULE__{} = depth, fun) when is_function(fun, 1) do
    with {:ok, depth} <- validate(depth),
         {:ok, %Image{} = image} <- fun.(to_gray16(depth)),
         do: from_gray16(image, semantics: depth.semantics, scale: depth.scale)
  end

  @doc "Distance in metres at a pixel; `{:ok, nil}` where it is not known (0)."
  @spec fetch_distance(t(), integer(), integer()) :: {:ok, float() | nil} | {:error, Error.t()}
  def fetch_distance(%__MODULE__{} = depth, x, y) do
    case Image.fetch_pixel(to_gray16(depth), x, y) do
      {:ok, [0]} -> {:ok, nil}
      {:ok, [value]} -> {:ok, value * depth.scale}
      {:error, _} = error -> error
    end
  end

  @doc """
  The distance in metres at a pixel, made up from its neighbours where it is not known (`invalid:`, default 0): the
  nearest known values to the left, right, above and below, each weighted by one over how far away it is. `{:ok, nil}`
  when there is none in any direction.

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
          {value, offset} <- [look(depth, x, y, {dx, dy}, invalid)],
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

  defp look(depth, x, y, {dx, dy}, invalid) do
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
