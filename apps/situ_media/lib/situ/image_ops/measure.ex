defmodule Situ.ImageOps.Measure do
  @moduledoc false
  # Measurements of images: statistics, histograms and comparisons. `Situ.ImageOps` documents the functions.
  alias Situ.{Image, Rect}
  alias Situ.Image.Format
  alias Situ.ImageOps.ArgumentCheck
  alias Situ.Media.NativeKernel

  def statistics(%Image{} = image, opts \\ []) do
    with {:ok, values} <- measure_rect(image, :statistics, opts) do
      maps =
        Enum.map(values, fn {min, max, mean, deviation} ->
          %{min: min, max: max, mean: mean, deviation: deviation}
        end)

      {:ok, image.format |> Format.channels() |> Enum.zip(maps) |> Map.new()}
    end
  end

  def average_color(%Image{} = image, opts \\ []) do
    with {:ok, channels} <- statistics(image, opts),
         do: {:ok, Map.new(channels, fn {name, c} -> {name, c.mean} end)}
  end

  def histogram(%Image{} = image, opts \\ []) do
    with {:ok, bins} <- measure_rect(image, :histogram, opts),
         do: {:ok, image.format |> Format.channels() |> Enum.zip(bins) |> Map.new()}
  end

  def compare(%Image{} = a, %Image{} = b, opts \\ []) do
    opts = Keyword.validate!(opts, tolerance: 0, outliers: 0.0)

    with {:ok, a} <- Image.validate(a),
         {:ok, b} <- Image.validate(b),
         {:ok, {max, mean, outliers}} <-
           NativeKernel.run_image({:compare, a, b, opts[:tolerance]}, byte_size(a.data) / 500) do
      {:ok, %{equal?: outliers <= opts[:outliers], max: max, mean: mean, outliers: outliers}}
    end
  end

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
