defmodule Situ.ImageOps.CostEstimate do
  @moduledoc false
  # Estimates how long an operation on an image takes, in microseconds, from the bytes to read and write. Long jobs run
  # on a dirty scheduler, and a job without an estimate counts as long.

  alias Situ.Image
  alias Situ.Image.Format

  @unknown 100_000.0

  @doc "Estimates decoding a JPEG from the size in its header. Progressive files have no estimate."
  @spec jpeg_cost(binary()) :: float()
  def jpeg_cost(<<0xFF, 0xD8, rest::binary>>), do: segment_cost(rest)
  def jpeg_cost(_), do: @unknown

  # Only baseline and sequential frames have an estimate.
  defp segment_cost(<<0xFF, marker, _::16, _, height::16, width::16, _::binary>>)
       when marker in [0xC0, 0xC1],
       do: width * height / 150

  defp segment_cost(<<0xFF, marker, _::binary>>)
       when marker in 0xC2..0xCF and marker not in [0xC4, 0xC8, 0xCC],
       do: @unknown

  defp segment_cost(<<0xFF, 0xFF, rest::binary>>), do: segment_cost(<<0xFF, rest::binary>>)

  defp segment_cost(<<0xFF, _, length::16, rest::binary>>)
       when length >= 2 and byte_size(rest) >= length - 2,
       do: rest |> binary_part(length - 2, byte_size(rest) - length + 2) |> segment_cost()

  defp segment_cost(_), do: @unknown

  @doc "Estimates resizing. Filters that use all covered pixels read the complete image."
  @spec resize_cost(Image.t(), pos_integer(), pos_integer(), atom()) :: float()
  def resize_cost(image, width, height, filter) do
    bytes = Format.bytes_per_pixel(image.format)
    made = width * height * bytes * 1.5
    (count_read_pixels(image, height, filter) * bytes + made) / 1000
  end

  defp count_read_pixels(image, _height, :lanczos), do: image.width * image.height * 3.0

  defp count_read_pixels(image, _height, filter) when filter in [:area, :smooth],
    do: image.width * image.height * 1.5

  defp count_read_pixels(image, height, _filter),
    do: min(image.height, 4 * height) * image.width * 0.1
end
