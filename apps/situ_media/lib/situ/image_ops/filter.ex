defmodule Situ.ImageOps.Filter do
  @moduledoc false
  # OpenCV filters: blurs, edges, morphology and histogram equalization. Call these functions
  # through `Situ.ImageOps`.
  alias Situ.Image
  alias Situ.ImageOps.ArgumentCheck
  alias Situ.Media.NativeKernel

  @doc """
  Applies a Gaussian blur. `size` is the odd side of the window; `nil` covers 3 standard deviations on each side
  (sigma 1.4: 9).

      iex> Situ.ImageOps.blur!(Situ.Image.new_filled(8, 8, :gray8, 100), 1.4) |> Situ.Image.fetch_pixel(4, 4)
      {:ok, [100]}
  """
  @spec blur(Image.t(), number(), keyword()) :: Image.result()
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

  @doc """
  Replaces each pixel with the mean of a window of `size` x `size` pixels. `size` must be odd.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.box_blur!(dot, 3).data
      <<0, 30, 30, 30, 0>>
  """
  @spec box_blur(Image.t(), pos_integer()) :: Image.result()
  def box_blur(%Image{} = image, size), do: run_opencv(image, {:box_blur, image, size}, 0.6)

  @doc """
  Replaces each pixel with the median of a window of `size` x `size` pixels. `size` must be odd. Sizes above 5 need an
  8-bit format.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.median_blur!(dot, 3).data
      <<0, 0, 0, 0, 0>>
  """
  @spec median_blur(Image.t(), pos_integer()) :: Image.result()
  def median_blur(%Image{} = image, size), do: run_opencv(image, {:median_blur, image, size}, 3)

  @doc """
  Detects Canny edges in a `:gray8` image: 255 on an edge, else 0. `low` and `high` are the hysteresis thresholds.

      iex> step = Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(8, 8, :gray8), {4, 0, 4, 8}, color: 200)
      iex> step |> Situ.ImageOps.canny!(60, 120) |> Situ.ImageOps.crop!({0, 4, 8, 1}) |> Situ.Image.pixel_bytes()
      <<0, 0, 0, 255, 0, 0, 0, 0>>
  """
  @spec canny(Image.t(), number(), number()) :: Image.result()
  def canny(%Image{} = image, low, high) do
    with {:ok, [low, high]} <- ArgumentCheck.check_floats([low, high], "thresholds"),
         do: run_opencv(image, {:canny, image, low, high}, 6)
  end

  @doc """
  Computes the edge strength of a `:gray8` image as the mean of the two absolute Sobel 3x3 derivatives. Each derivative
  is clipped at 255 first (as with OpenCV's `convertScaleAbs` and `addWeighted` in 8 bits).

      iex> step = Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(8, 8, :gray8), {4, 0, 4, 8}, color: 200)
      iex> step |> Situ.ImageOps.sobel!() |> Situ.ImageOps.crop!({0, 4, 8, 1}) |> Situ.Image.pixel_bytes()
      <<0, 0, 0, 128, 128, 0, 0, 0>>
  """
  @spec sobel(Image.t()) :: Image.result()
  def sobel(%Image{} = image), do: run_opencv(image, {:sobel, image}, 2)

  @doc """
  Replaces each pixel with the minimum of a window of `size` x `size` pixels. `size` must be odd.

      iex> hole = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<90, 90, 0, 90, 90>>)
      iex> Situ.ImageOps.erode!(hole, 3).data
      <<90, 0, 0, 0, 90>>
  """
  @spec erode(Image.t(), pos_integer()) :: Image.result()
  def erode(%Image{} = image, size), do: apply_morphology(image, :erode, size)

  @doc """
  Replaces each pixel with the maximum of a window of `size` x `size` pixels. `size` must be odd.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.dilate!(dot, 3).data
      <<0, 90, 90, 90, 0>>
  """
  @spec dilate(Image.t(), pos_integer()) :: Image.result()
  def dilate(%Image{} = image, size), do: apply_morphology(image, :dilate, size)

  @doc """
  Erodes and then dilates the image, which removes specks.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.open!(dot, 3).data
      <<0, 0, 0, 0, 0>>
  """
  @spec open(Image.t(), pos_integer()) :: Image.result()
  def open(%Image{} = image, size), do: apply_morphology(image, :open, size)

  @doc """
  Dilates and then erodes the image, which fills holes.

      iex> hole = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<90, 90, 0, 90, 90>>)
      iex> Situ.ImageOps.close!(hole, 3).data
      <<90, 90, 90, 90, 90>>
  """
  @spec close(Image.t(), pos_integer()) :: Image.result()
  def close(%Image{} = image, size), do: apply_morphology(image, :close, size)

  @doc """
  Equalizes the histogram of a `:gray8` image.

      iex> image = Situ.Image.new!(width: 4, height: 1, format: :gray8, data: <<10, 11, 12, 12>>)
      iex> Situ.ImageOps.equalize!(image).data
      <<0, 85, 255, 255>>
  """
  @spec equalize(Image.t()) :: Image.result()
  def equalize(%Image{} = image), do: run_opencv(image, {:equalize, image}, 0.6)

  defp apply_morphology(image, kind, size),
    do: run_opencv(image, {:morphology, image, kind, size}, 1)

  defp run_opencv(image, job, ns_per_byte) do
    with {:ok, image} <- Image.validate(image),
         do: NativeKernel.run_opencv(job, byte_size(image.data) * ns_per_byte / 1000)
  end
end
