defmodule Situ.ImageOps.Measure do
  @moduledoc false
  # Measurements of images: statistics, histograms and comparisons. Call these functions through
  # `Situ.ImageOps`.
  alias Situ.{Error, Image, Rect}
  alias Situ.Image.Format
  alias Situ.ImageOps.ArgumentCheck
  alias Situ.Media.NativeKernel

  @type channel :: %{min: integer(), max: integer(), mean: float(), deviation: float()}

  @doc """
  Returns the minimum, maximum, mean and standard deviation (of the population) of each channel, by name. `rect:`
  restricts it to a part.

      iex> image = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<10, 20>>)
      iex> Situ.ImageOps.statistics(image)
      {:ok, %{gray: %{min: 10, max: 20, mean: 15.0, deviation: 5.0}}}
  """
  @spec statistics(Image.t(), keyword()) :: {:ok, %{atom() => channel()}} | {:error, Error.t()}
  def statistics(%Image{} = image, opts \\ []) do
    with {:ok, values} <- measure_rect(image, :statistics, opts) do
      maps =
        Enum.map(values, fn {min, max, mean, deviation} ->
          %{min: min, max: max, mean: mean, deviation: deviation}
        end)

      {:ok, image.format |> Format.channels() |> Enum.zip(maps) |> Map.new()}
    end
  end

  @doc """
  Returns the mean of each channel, by name. `rect:` restricts it to a part.

      iex> Situ.ImageOps.average_color(Situ.Image.new_filled(2, 2, :bgr24, [1, 2, 3]))
      {:ok, %{blue: 1.0, green: 2.0, red: 3.0}}
  """
  @spec average_color(Image.t(), keyword()) :: {:ok, %{atom() => float()}} | {:error, Error.t()}
  def average_color(%Image{} = image, opts \\ []) do
    with {:ok, channels} <- statistics(image, opts),
         do: {:ok, Map.new(channels, fn {name, c} -> {name, c.mean} end)}
  end

  @doc """
  Counts how often each value occurs, with 256 counts per channel (16-bit values by their high byte). `rect:` restricts
  it to a part.

      iex> {:ok, %{gray: counts}} = Situ.ImageOps.histogram(Situ.Image.new_filled(2, 2, :gray8, 3))
      iex> Enum.take(counts, 5)
      [0, 0, 0, 4, 0]
  """
  @spec histogram(Image.t(), keyword()) ::
          {:ok, %{atom() => [non_neg_integer()]}} | {:error, Error.t()}
  def histogram(%Image{} = image, opts \\ []) do
    with {:ok, bins} <- measure_rect(image, :histogram, opts),
         do: {:ok, image.format |> Format.channels() |> Enum.zip(bins) |> Map.new()}
  end

  @doc """
  Compares two images of the same size and format. Returns the largest and mean difference of channel values, and the
  fraction of values that differ by more than `tolerance:` (default 0). `equal?` is true if that fraction is at most
  `outliers:` (default 0).

      iex> {a, b} = {Situ.Image.new_filled(2, 1, :gray8, 3), Situ.Image.new_filled(2, 1, :gray8, 5)}
      iex> Situ.ImageOps.compare(a, b, tolerance: 2)
      {:ok, %{equal?: true, max: 2, mean: 2.0, outliers: 0.0}}
  """
  @spec compare(Image.t(), Image.t(), keyword()) ::
          {:ok, %{equal?: boolean(), max: integer(), mean: float(), outliers: float()}}
          | {:error, Error.t()}
  def compare(%Image{} = a, %Image{} = b, opts \\ []) do
    opts = Keyword.validate!(opts, tolerance: 0, outliers: 0.0)

    with {:ok, a} <- Image.validate(a),
         {:ok, b} <- Image.validate(b),
         {:ok, {max, mean, outliers}} <-
           NativeKernel.run_image({:compare, a, b, opts[:tolerance]}, byte_size(a.data) / 500) do
      {:ok, %{equal?: outliers <= opts[:outliers], max: max, mean: mean, outliers: outliers}}
    end
  end

  @doc """
  Converts an image to 32-bit floats for a model: `value * scale + offset`, red first, without alpha.

  `layout:` is `:nhwc` (default) or `:nchw`, `scale:` defaults to 1/255 (1/65535 for 16 bit), and `offset:` to 0.0.
  Returns a binary of native floats and its shape.

      iex> {:ok, {data, shape}} = Situ.ImageOps.to_f32(Situ.Image.new_filled(1, 1, :bgr24, [0, 51, 255]))
      iex> {shape, for(<<v::float-native-32 <- data>>, do: Float.round(v, 3))}
      {{1, 1, 1, 3}, [1.0, 0.2, 0.0]}
  """
  @spec to_f32(Image.t(), keyword()) :: {:ok, {binary(), tuple()}} | {:error, Error.t()}
  def to_f32(%Image{} = image, opts \\ []) do
    opts = Keyword.validate!(opts, layout: :nhwc, scale: nil, offset: 0.0)
    {w, h} = {image.width, image.height}
    channels = image.format |> Format.channels() |> length() |> min(3)
    bits = Format.bits_per_channel(image.format)
    scale = opts[:scale] || 1 / (Bitwise.bsl(1, bits) - 1)
    first? = opts[:layout] == :nchw

    with {:ok, image} <- Image.validate(image),
         {:ok, [scale, offset]} <-
           ArgumentCheck.check_floats([scale, opts[:offset]], "scale and offset"),
         job = {:to_f32, image, first?, scale, offset},
         {:ok, data} <- NativeKernel.run_image(job, byte_size(image.data) / 500) do
      {:ok, {data, if(first?, do: {1, channels, h, w}, else: {1, h, w, channels})}}
    end
  end

  defp measure_rect(image, kind, opts) do
    rect =
      case Keyword.validate!(opts, rect: nil)[:rect] do
        nil -> nil
        %Rect{} = r -> {round(r.x), round(r.y), round(r.width), round(r.height)}
        {_, _, _, _} = rect -> rect
      end

    with {:ok, image} <- Image.validate(image),
         do: NativeKernel.run_image({kind, image, rect}, byte_size(image.data) / 500)
  end
end
