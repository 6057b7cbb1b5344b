defmodule Situ.ImageOps.Filter do
  @moduledoc false
  # OpenCV filters: blurs, edges, morphology and histogram equalization. `Situ.ImageOps` documents the functions.
  alias Situ.Image
  alias Situ.ImageOps.ArgumentCheck
  alias Situ.Media.NativeKernel

  def blur(%Image{} = image, sigma, opts \\ []) do
    opts = Keyword.validate!(opts, size: nil)

    with {:ok, [sigma]} <- ArgumentCheck.check_floats([sigma], "sigma"),
         {:ok, size} <- window_size(opts[:size], sigma) do
      # A window much larger than the image would take longer without changing the result.
      run_opencv(image, {:gaussian, image, size, sigma}, size / 9)
    end
  end

  @widest 4095
  defp window_size(nil, sigma) when sigma > 0 and sigma < @widest / 6.1,
    do: {:ok, 2 * ceil(3 * sigma - 0.5) + 1}

  defp window_size(nil, sigma),
    do:
      ArgumentCheck.bad_option(
        "sigma must be above 0 and below #{div(@widest, 6)}, got: #{sigma}"
      )

  defp window_size(size, _sigma), do: ArgumentCheck.check_integer(size, 1..@widest, "size")

  def box_blur(%Image{} = image, size), do: run_opencv(image, {:box_blur, image, size}, 0.6)

  def median_blur(%Image{} = image, size), do: run_opencv(image, {:median_blur, image, size}, 3)

  def canny(%Image{} = image, low, high) do
    with {:ok, [low, high]} <- ArgumentCheck.check_floats([low, high], "thresholds"),
         do: run_opencv(image, {:canny, image, low, high}, 6)
  end

  def sobel(%Image{} = image), do: run_opencv(image, {:sobel, image}, 2)

  def erode(%Image{} = image, size), do: apply_morphology(image, :erode, size)

  def dilate(%Image{} = image, size), do: apply_morphology(image, :dilate, size)

  def open(%Image{} = image, size), do: apply_morphology(image, :open, size)

  def close(%Image{} = image, size), do: apply_morphology(image, :close, size)

  def equalize(%Image{} = image), do: run_opencv(image, {:equalize, image}, 0.6)

  defp apply_morphology(image, kind, size),
    do: run_opencv(image, {:morphology, image, kind, size}, 1)

  defp run_opencv(image, job, ns_per_byte) do
    with {:ok, image} <- Image.validate(image),
         do: NativeKernel.run_opencv(job, byte_size(image.data) * ns_per_byte / 1000)
  end
end
