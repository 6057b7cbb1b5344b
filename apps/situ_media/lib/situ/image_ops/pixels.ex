defmodule Situ.ImageOps.Pixels do
  @moduledoc false
  # Operations on pixels: conversion, inversion, thresholds, differences, convolution and
  # pseudo-color. Call these functions through `Situ.ImageOps`.
  alias Situ.{DepthImage, Error, Image}
  alias Situ.Image.Format
  alias Situ.ImageOps.ArgumentCheck
  alias Situ.Media.NativeKernel

  @huge 0xFFFFFFFF

  @thresholds [:binary, :binary_inverted, :truncate, :to_zero, :to_zero_inverted]

  @doc """
  Converts an image to another format. Gray is `(4897 R + 9617 G + 1868 B) >> 14`, so white becomes 254. 8 bits are
  widened by `v * 257`, and 16 bits are narrowed by `v >> 8`. A missing alpha channel becomes opaque.

      iex> red = Situ.Image.new_filled(1, 1, :rgb24, [255, 0, 0])
      iex> for format <- [:gray8, :bgr24, :bgra32, :rgba64], do: Situ.ImageOps.convert!(red, format).data
      [<<76>>, <<0, 0, 255>>, <<0, 0, 255, 255>>, <<255, 255, 0, 0, 0, 0, 255, 255>>]
  """
  @spec convert(Image.t(), Format.t()) :: Image.result()
  def convert(image, format)
  def convert(%Image{format: format} = image, format), do: Image.validate(image)

  def convert(%Image{} = image, format) do
    with {:ok, image} <- Image.validate(image),
         :ok <- check_format(format) do
      NativeKernel.run_image({:convert, image, format}, image.width * image.height / 1000)
    end
  end

  defp check_format(format) do
    if format in Format.list_all() do
      :ok
    else
      fix = "use one of #{inspect(Format.list_all())}"
      {:error, Error.new(:bad_format, "unknown pixel format #{inspect(format)}", fix: fix)}
    end
  end

  @doc """
  Inverts every channel to 255 - v (65535 - v for 16 bit). Alpha and unused channels are unchanged.

      iex> Situ.ImageOps.invert!(Situ.Image.new_filled(1, 1, :bgra32, [0, 1, 255, 40])).data
      <<255, 254, 0, 40>>
  """
  @spec invert(Image.t()) :: Image.result()
  def invert(%Image{} = image), do: run_kernel({:invert, image})

  @doc """
  Compares every channel (including alpha) with `threshold`:
  `:binary` v > t ? max : 0, `:binary_inverted` v > t ? 0 : max, `:truncate` v > t ? t : v, `:to_zero` v > t ? v : 0,
  `:to_zero_inverted` v > t ? 0 : v. `max` defaults to the format's largest value.

      iex> image = Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<9, 10, 11>>)
      iex> for kind <- [:binary, :binary_inverted, :truncate, :to_zero, :to_zero_inverted],
      ...>     do: Situ.ImageOps.threshold!(image, 10, kind).data
      [<<0, 0, 255>>, <<255, 255, 0>>, <<9, 10, 10>>, <<0, 0, 11>>, <<9, 10, 0>>]
  """
  @spec threshold(Image.t(), non_neg_integer(), atom(), keyword()) :: Image.result()
  def threshold(%Image{} = image, threshold, kind \\ :binary, opts \\ [])
      when kind in @thresholds do
    max = Keyword.validate!(opts, [:max])[:max] || 65_535

    with {:ok, threshold} <- ArgumentCheck.check_integer(threshold, 0..@huge, "a threshold"),
         {:ok, max} <- ArgumentCheck.check_integer(max, 0..@huge, "max") do
      run_kernel({:threshold, image, min(threshold, 65_535), min(max, 65_535), kind})
    end
  end

  @doc """
  Extracts one channel as grayscale of the same depth, by its position in memory (0 is blue in `:bgr24`) or its name.

      iex> Situ.ImageOps.extract_channel!(Situ.Image.new_filled(1, 1, :bgr24, [1, 2, 3]), :red).data
      <<3>>
  """
  @spec extract_channel(Image.t(), non_neg_integer() | atom()) :: Image.result()
  def extract_channel(%Image{} = image, name) when is_atom(name) do
    case Enum.find_index(Format.channels(image.format), &(&1 == name)) do
      nil ->
        {:error,
         Error.new(:bad_option, "#{inspect(image.format)} has no channel #{inspect(name)}")}

      index ->
        extract_channel(image, index)
    end
  end

  def extract_channel(%Image{} = image, index) when index in 0..255,
    do: run_kernel({:extract_channel, image, index})

  @doc """
  Computes |a - b| for every channel of two images of the same size and format.

      iex> {a, b} = {Situ.Image.new_filled(1, 1, :gray8, 3), Situ.Image.new_filled(1, 1, :gray8, 10)}
      iex> Situ.ImageOps.absdiff!(a, b).data
      <<7>>
  """
  @spec absdiff(Image.t(), Image.t()) :: Image.result()
  def absdiff(%Image{} = a, %Image{} = b) do
    with {:ok, b} <- Image.validate(b), do: run_kernel({:absolute_difference, a, b})
  end

  @doc """
  Convolves a grayscale image with a small kernel of integers (a list of rows; kernels of odd size have a center). The
  result is the sum over the taps inside the image, divided by the **number of these taps** (not by their sum),
  truncated and clipped. This is \\\\psi's rule.

      iex> image = Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<10, 20, 40>>)
      iex> Situ.ImageOps.convolve!(image, [[1, 1, 1]]).data
      <<15, 23, 30>>
  """
  @spec convolve(Image.t(), [[integer()]]) :: Image.result()
  def convolve(%Image{} = image, [row | _] = rows) do
    {width, height} = {length(row), length(rows)}

    if Enum.all?(rows, &(length(&1) == width)) do
      with {:ok, image} <- Image.validate(image) do
        cost = image.width * image.height * width * height / 500
        NativeKernel.run_image({:convolve, image, width, height, List.flatten(rows)}, cost)
      end
    else
      {:error, Error.new(:bad_option, "the rows of a kernel must have the same length")}
    end
  end

  @doc """
  Renders depth as color: `near` meters is blue and `far` is red. Pixels outside this range or equal to `invalid:`
  (default 0) are black, or transparent with `transparent: true`. The result is `:bgra32`.

      iex> depth = Situ.DepthImage.new!(width: 3, height: 1, data: <<0::16, 500::little-16, 2000::little-16>>)
      iex> {:ok, colored} = Situ.ImageOps.pseudo_colorize(depth, {0.5, 2.0})
      iex> colored.data
      <<0, 0, 0, 255, 255, 0, 0, 255, 0, 0, 255, 255>>
  """
  @spec pseudo_colorize(DepthImage.t(), {number(), number()}, keyword()) :: Image.result()
  def pseudo_colorize(%DepthImage{} = depth, {near, far}, opts \\ []) when near < far do
    opts = Keyword.validate!(opts, invalid: 0, transparent: false)
    {from, to} = {near / depth.scale, far / depth.scale}

    with {:ok, depth} <- DepthImage.validate(depth) do
      image = DepthImage.to_gray16(depth)
      job = {:pseudo_colorize, image, from, to, opts[:invalid], opts[:transparent]}
      NativeKernel.run_image(job, image.width * image.height / 200)
    end
  end

  defp run_kernel(job) do
    with {:ok, image} <- Image.validate(elem(job, 1)),
         do: NativeKernel.run_image(job, byte_size(image.data) / 2000)
  end
end
