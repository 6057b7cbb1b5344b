defmodule Situ.Image.Format do
  @moduledoc false
  # Pixel formats and their sizes. `Situ.Image` has the table of formats.

  @type t :: :gray8 | :gray16 | :bgr24 | :rgb24 | :bgrx32 | :bgra32 | :rgba32 | :rgba64

  # {format, code in files, bits per channel, channels}
  @table [
    {:gray8, 1, 8, [:gray]},
    {:gray16, 2, 16, [:gray]},
    {:bgr24, 3, 8, [:blue, :green, :red]},
    {:rgb24, 4, 8, [:red, :green, :blue]},
    {:bgrx32, 5, 8, [:blue, :green, :red, :unused]},
    {:bgra32, 6, 8, [:blue, :green, :red, :alpha]},
    {:rgba32, 7, 8, [:red, :green, :blue, :alpha]},
    {:rgba64, 8, 16, [:red, :green, :blue, :alpha]}
  ]

  @doc "Lists all formats."
  @spec list_all() :: [t()]
  def list_all, do: unquote(Enum.map(@table, &elem(&1, 0)))

  @doc """
  Returns the number of bytes in one pixel.

      iex> Situ.Image.Format.bytes_per_pixel(:bgr24)
      3
  """
  @spec bytes_per_pixel(t()) :: pos_integer()
  for {format, _code, bits, channels} <- @table do
    def bytes_per_pixel(unquote(format)), do: unquote(div(bits * length(channels), 8))
  end

  @doc "Returns the number of bits in one channel, 8 or 16."
  @spec bits_per_channel(t()) :: 8 | 16
  for {format, _code, bits, _channels} <- @table do
    def bits_per_channel(unquote(format)), do: unquote(bits)
  end

  @doc """
  Lists the channels in memory order.

      iex> Situ.Image.Format.channels(:rgba64)
      [:red, :green, :blue, :alpha]
  """
  @spec channels(t()) :: [atom()]
  for {format, _code, _bits, channels} <- @table do
    def channels(unquote(format)), do: unquote(channels)
  end

  @doc false
  @spec code(t()) :: byte()
  for {format, code, _bits, _channels} <- @table do
    def code(unquote(format)), do: unquote(code)
  end

  @doc false
  @spec from_code(byte()) :: {:ok, t()} | {:error, Situ.Error.t()}
  for {format, code, _bits, _channels} <- @table do
    def from_code(unquote(code)), do: {:ok, unquote(format)}
  end

  def from_code(code),
    do: {:error, Situ.Error.new(:bad_image, "pixel format code #{code} is unknown")}

  @doc """
  Encodes channel values, in memory order, as the bytes of one pixel. One number is used for every channel.

      iex> Situ.Image.Format.pack_pixel!(:gray16, 1)
      <<1, 0>>
      iex> Situ.Image.Format.pack_pixel!(:bgr24, [1, 2])
      ** (ArgumentError) :bgr24 takes 3 channel values of 0..255, got: [1, 2]
  """
  @spec pack_pixel!(t(), non_neg_integer() | [non_neg_integer()]) :: binary()
  def pack_pixel!(format, value) when is_integer(value),
    do: pack_pixel!(format, List.duplicate(value, length(channels(format))))

  def pack_pixel!(format, values) when is_list(values) do
    bits = bits_per_channel(format)
    max = Bitwise.bsl(1, bits) - 1
    count = length(channels(format))

    unless length(values) == count and Enum.all?(values, &(is_integer(&1) and &1 in 0..max)) do
      raise ArgumentError,
            "#{inspect(format)} takes #{count} channel values of 0..#{max}, got: " <>
              inspect(values, charlists: :as_lists)
    end

    for v <- values, into: <<>>, do: <<v::little-size(bits)>>
  end

  @doc "Decodes the bytes of one pixel to its channel values."
  @spec unpack_pixel(t(), binary()) :: [non_neg_integer()]
  def unpack_pixel(format, bytes) do
    case bits_per_channel(format) do
      8 -> :binary.bin_to_list(bytes)
      16 -> for <<v::little-16 <- bytes>>, do: v
    end
  end
end
