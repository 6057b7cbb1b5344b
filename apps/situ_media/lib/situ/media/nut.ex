defmodule Situ.Media.Nut do
  @moduledoc false
  # The basic elements of NUT, FFmpeg's own container: variable-length numbers, start codes, checksums and time bases.
  # Situ and `ffmpeg` exchange decoded images and audio as a NUT stream, because NUT keeps the exact time base of every
  # stream and needs no seeking. For the format, see <https://ffmpeg.org/~michael/nut.txt>.
  import Bitwise

  @typedoc "Seconds per tick, as a fraction."
  @type time_base :: {num :: pos_integer(), den :: pos_integer()}

  @typedoc "One elementary stream: raw images of one size, or interleaved samples."
  @type stream :: %{
          required(:id) => non_neg_integer(),
          required(:class) => :video | :audio | :other,
          required(:fourcc) => binary(),
          required(:time_base) => time_base(),
          optional(:width) => pos_integer(),
          optional(:height) => pos_integer(),
          optional(:rate) => pos_integer(),
          optional(:channels) => pos_integer()
        }

  @file_id "nut/multimedia container\0"
  @startcodes %{
    main: <<"NM", 0x7A561F5F04AD::48>>,
    stream: <<"NS", 0x11405BF2F9DB::48>>,
    syncpoint: <<"NK", 0xE4ADEECA4569::48>>,
    index: <<"NX", 0xDD672F23E64E::48>>,
    info: <<"NI", 0xAB68B596BA78::48>>
  }

  @doc false
  @spec file_id() :: binary()
  def file_id, do: @file_id

  @doc false
  @spec startcode(atom()) :: <<_::64>>
  @spec startcode_name(binary()) :: {:ok, atom()} | :error
  for {name, code} <- @startcodes do
    def startcode(unquote(name)), do: unquote(code)

    @doc false
    def startcode_name(unquote(code)), do: {:ok, unquote(name)}
  end

  def startcode_name(_), do: :error

  @doc """
  Encodes an unsigned number in groups of 7 bits, most significant first. All bytes but the last have the top bit set.

      iex> Situ.Media.Nut.encode_varint(300)
      <<0x82, 0x2C>>
      iex> Situ.Media.Nut.to_ns(1, {1, 25})
      40_000_000
  """
  @spec encode_varint(non_neg_integer()) :: binary()
  def encode_varint(value) when is_integer(value) and value >= 0,
    do: encode_groups(value >>> 7, <<value &&& 127>>)

  defp encode_groups(0, bytes), do: bytes

  defp encode_groups(value, bytes),
    do: encode_groups(value >>> 7, <<1::1, value &&& 127::7, bytes::binary>>)

  @doc """
  Reads a number written by `encode_varint/1`.

      iex> Situ.Media.Nut.take_varint(<<0x82, 0x2C, 9>>)
      {300, <<9>>}
      iex> Situ.Media.Nut.take_varint(<<0x82>>)
      :error
  """
  @spec take_varint(binary()) :: {non_neg_integer(), binary()} | :error
  def take_varint(bytes), do: take_varint(bytes, 0, 0)

  # Ten groups hold 70 bits; no writer produces larger numbers.
  defp take_varint(<<1::1, group::7, rest::binary>>, value, n) when n < 10,
    do: take_varint(rest, value <<< 7 ||| group, n + 1)

  defp take_varint(<<0::1, group::7, rest::binary>>, value, _n), do: {value <<< 7 ||| group, rest}
  defp take_varint(_, _value, _n), do: :error

  @doc """
  Decodes a signed number from an unsigned one: 0, 1, -1, 2, -2 ...

      iex> Enum.map(0..4, &Situ.Media.Nut.decode_signed/1)
      [0, 1, -1, 2, -2]
  """
  @spec decode_signed(non_neg_integer()) :: integer()
  def decode_signed(value) when (value &&& 1) == 1, do: (value + 1) >>> 1
  def decode_signed(value), do: -(value >>> 1)

  @doc "Converts ticks of a time base to nanoseconds, rounded to the nearest."
  @spec to_ns(integer(), time_base()) :: integer()
  def to_ns(ticks, {num, den}),
    do: Integer.floor_div(ticks * num * 2_000_000_000 + den, 2 * den)

  @doc "Converts ticks of one time base to ticks of another, rounded down as syncpoints require."
  @spec rescale_ticks(integer(), time_base(), time_base()) :: integer()
  def rescale_ticks(ticks, {num, den}, {to_num, to_den}),
    do: Integer.floor_div(ticks * num * to_den, den * to_num)

  @poly 0x04C11DB7
  @table (for byte <- 0..255 do
            Enum.reduce(1..8, byte <<< 24, fn _, crc ->
              shifted = crc <<< 1 &&& 0xFFFFFFFF
              if (crc &&& 0x80000000) == 0, do: shifted, else: bxor(shifted, @poly)
            end)
          end)
         |> List.to_tuple()

  @doc """
  Computes the checksum of NUT headers: CRC-32 with polynomial 04C11DB7, most significant bit first, starting at 0.
  """
  @spec header_checksum(binary()) :: non_neg_integer()
  def header_checksum(bytes) do
    for <<byte <- bytes>>, reduce: 0 do
      crc -> bxor(crc <<< 8 &&& 0xFFFFFFFF, elem(@table, bxor(crc >>> 24, byte)))
    end
  end
end
