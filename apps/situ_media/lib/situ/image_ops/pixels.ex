defmodule Situ.ImageOps.Pixels do
  @moduledoc false
  # Operations on pixels: conversion, inversion, thresholds, differences, convolution and pseudo-color.
  # `Situ.ImageOps` documents the functions.
  alias Situ.{DepthImage, Error, Image}
  alias Situ.Image.Format
  alias Situ.ImageOps.ArgumentCheck
  alias Situ.Media.NativeKernel

  @huge 0xFFFFFFFF

  @thresholds [:binary, :binary_inverted, :truncate, :to_zero, :to_zero_inverted]

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

  def invert(%Image{} = image), do: run_kernel({:invert, image})

  def threshold(%Image{} = image, threshold, kind \\ :binary, opts \\ [])
      when kind in @thresholds do
    max = Keyword.validate!(opts, [:max])[:max] || 65_535

    with {:ok, threshold} <- ArgumentCheck.check_integer(threshold, 0..@huge, "a threshold"),
         {:ok, max} <- ArgumentCheck.check_integer(max, 0..@huge, "max") do
      run_kernel({:threshold, image, min(threshold, 65_535), min(max, 65_535), kind})
    end
  end

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

  def absdiff(%Image{} = a, %Image{} = b) do
    with {:ok, b} <- Image.validate(b), do: run_kernel({:absolute_difference, a, b})
  end

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
