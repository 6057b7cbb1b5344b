defmodule Situ.Bridge.Psi.Bytes do
  @moduledoc false
  # Decodes the primitives in \psi's files: little-endian numbers, strings with a 32-bit length, and .NET times.
  import Bitwise

  # 1970-01-01 in ticks of 100 ns since the year 1.
  @epoch 621_355_968_000_000_000
  @kind_bits 0x3FFF_FFFF_FFFF_FFFF
  @max_ticks 3_155_378_975_999_999_999

  @doc """
  Converts a .NET time to nanoseconds since 1970. The top two bits hold the kind (UTC, local, unspecified) and are
  ignored.

      iex> Situ.Bridge.Psi.Bytes.parse_time(0x48D924F4C841A000)
      1622548800000000000
      iex> Situ.Bridge.Psi.Bytes.parse_time(0)
      -62135596800000000000
  """
  @spec parse_time(integer()) :: Situ.Time.t()
  def parse_time(binary), do: ((binary &&& @kind_bits) - @epoch) * 100

  @doc """
  Returns whether .NET can represent the time, that is, whether it is between the years 1 and 9999.

      iex> Situ.Bridge.Psi.Bytes.valid_time?(0x48D924F4C841A000)
      true
      iex> Situ.Bridge.Psi.Bytes.valid_time?(0xFFFF_FFFF_FFFF_FFFF)
      false
  """
  @spec valid_time?(integer()) :: boolean()
  def valid_time?(binary), do: (binary &&& @kind_bits) <= @max_ticks

  @doc "Converts a .NET time like `parse_time/1`, but returns nil for the maximum time, which means \"not yet\"."
  @spec parse_optional_time(integer()) :: Situ.Time.t() | nil
  def parse_optional_time(binary),
    do: if((binary &&& @kind_bits) == @max_ticks, do: nil, else: parse_time(binary))

  @doc "Parses a string, which may be nil, and returns it with the remaining bytes."
  @spec parse_string(binary()) :: {:ok, String.t() | nil, binary()} | :error
  def parse_string(<<-1::little-signed-32, rest::binary>>), do: {:ok, nil, rest}

  def parse_string(<<n::little-signed-32, text::binary-size(n), rest::binary>>) when n >= 0,
    do: {:ok, :binary.copy(text), rest}

  def parse_string(_), do: :error
end
