defmodule Situ.Image.Color do
  @moduledoc false
  # Converts colours to the channels of a pixel format. `Situ.Image` documents the kinds of colours.
  alias Situ.Image.Format

  @names [
    black: {0, 0, 0},
    white: {255, 255, 255},
    red: {255, 0, 0},
    green: {0, 255, 0},
    blue: {0, 0, 255},
    yellow: {255, 255, 0},
    cyan: {0, 255, 255},
    magenta: {255, 0, 255},
    orange: {255, 165, 0},
    gray: {128, 128, 128}
  ]

  @type t ::
          non_neg_integer()
          | [non_neg_integer()]
          | {byte(), byte(), byte()}
          | {byte(), byte(), byte(), byte()}
          | atom()

  @doc """
  Returns the channel values of a colour in a format; raises `ArgumentError` if it is not a
  colour.

      iex> Situ.Image.Color.channel_values(:bgr24, :red)
      [0, 0, 255]
      iex> Situ.Image.Color.channel_values(:gray8, {255, 255, 255})
      [254]
      iex> Situ.Image.Color.channel_values(:rgba64, {255, 0, 0, 128})
      [65535, 0, 0, 32896]
  """
  @spec channel_values(Format.t(), t()) :: [non_neg_integer()]
  def channel_values(format, color) when is_list(color) or is_integer(color),
    do: Format.unpack_pixel(format, Format.pack_pixel!(format, color))

  def channel_values(format, name) when is_atom(name) do
    case Keyword.fetch(@names, name) do
      {:ok, rgb} ->
        channel_values(format, rgb)

      :error ->
        raise ArgumentError,
              "unknown colour #{inspect(name)}, known: #{inspect(Keyword.keys(@names))}"
    end
  end

  def channel_values(format, {r, g, b}), do: channel_values(format, {r, g, b, 255})

  def channel_values(format, {r, g, b, a} = color) do
    unless Enum.all?([r, g, b, a], &(&1 in 0..255)) do
      raise ArgumentError, "colour values must be in 0..255, got: #{inspect(color)}"
    end

    scale = if Format.bits_per_channel(format) == 16, do: 257, else: 1
    Enum.map(Format.channels(format), &(channel_value(&1, color) * scale))
  end

  @doc """
  Encodes a colour as the bytes of one pixel.

      iex> Situ.Image.Color.pack_pixel(:bgra32, :blue)
      <<255, 0, 0, 255>>
  """
  @spec pack_pixel(Format.t(), t()) :: binary()
  def pack_pixel(format, color), do: Format.pack_pixel!(format, channel_values(format, color))

  @doc false
  @spec to_opencv_scalar(Format.t(), t()) :: {float(), float(), float(), float()}
  def to_opencv_scalar(format, color) do
    [a, b, c, d] = Enum.take(channel_values(format, color) ++ [0, 0, 0], 4)
    {a * 1.0, b * 1.0, c * 1.0, d * 1.0}
  end

  defp channel_value(:red, {r, _, _, _}), do: r
  defp channel_value(:green, {_, g, _, _}), do: g
  defp channel_value(:blue, {_, _, b, _}), do: b
  defp channel_value(:alpha, {_, _, _, a}), do: a
  defp channel_value(:unused, _), do: 255

  defp channel_value(:gray, {r, g, b, _}),
    do: Bitwise.bsr(4897 * r + 9617 * g + 1868 * b, 14)
end
