defmodule Situ.Bridge.Format.Csv.Number do
  @moduledoc false
  # Formats numbers as .NET's invariant culture does, and parses fields into values.
  import Situ.BinarySize, only: [pinned_size: 1]

  @canonical ~r/\A-?(0|[1-9]\d*)(\.\d+)?([eE][+-]?\d{1,3})?\z/

  @doc """
  Returns the shortest digits that represent the number, without ".0". Numbers from 1E+15 on and below 0.0001 have an
  exponent.

      iex> Enum.map([1.0, 0.1, 1.5e20, 1.0e-5, -0.0, 12], &Situ.Bridge.Format.Csv.Number.encode_number/1)
      ["1", "0.1", "1.5E+20", "1E-05", "-0", "12"]
  """
  @spec encode_number(number() | atom()) :: String.t()
  def encode_number(n) when is_integer(n), do: Integer.to_string(n)
  def encode_number(:nan), do: "NaN"
  def encode_number(:infinity), do: "Infinity"
  def encode_number(:neg_infinity), do: "-Infinity"

  def encode_number(x) when is_float(x) do
    text = :erlang.float_to_binary(x, [:short])

    if abs(x) < 0.0001 or abs(x) >= 1.0e15 or :binary.match(text, "e") != :nomatch do
      {sign, digits, exponent} = split_digits(text)
      sign <> place_point(digits, exponent)
    else
      drop_zero_fraction(text)
    end
  end

  # Without an exponent, only a final ".0" has to be removed.
  defp drop_zero_fraction(text) do
    size = byte_size(text) - 2

    case text do
      <<integer::binary-pinned_size(size), ".0">> -> integer
      _ -> text
    end
  end

  # Returns the sign, the digits d and the exponent e of 0.ddd * 10^e.
  defp split_digits(text) do
    text = if String.contains?(text, "e"), do: text, else: text <> "e0"
    [mantissa, exponent] = String.split(text, "e")

    {sign, mantissa} =
      if String.starts_with?(mantissa, "-"),
        do: {"-", String.slice(mantissa, 1..-1//1)},
        else: {"", mantissa}

    [integer, fraction] = String.split(mantissa <> ".", ".") |> Enum.take(2)
    digits = integer <> fraction
    significant = String.trim_leading(digits, "0")
    point = byte_size(integer) - (byte_size(digits) - byte_size(significant))

    {sign, significant |> String.trim_trailing("0") |> or_zero(),
     String.to_integer(exponent) + point}
  end

  defp or_zero(""), do: "0"
  defp or_zero(digits), do: digits

  defp place_point("0", _exponent), do: "0"

  defp place_point(digits, exponent) when exponent > 15 or exponent < -3 do
    {first, rest} = String.split_at(digits, 1)
    fraction = if rest == "", do: "", else: "." <> rest
    power = exponent - 1
    sign = if power < 0, do: "-", else: "+"

    "#{first}#{fraction}E#{sign}#{power |> abs() |> Integer.to_string() |> String.pad_leading(2, "0")}"
  end

  defp place_point(digits, exponent) when exponent <= 0,
    do: "0." <> String.duplicate("0", -exponent) <> digits

  defp place_point(digits, exponent) do
    padded = String.pad_trailing(digits, exponent, "0")
    {integer, fraction} = String.split_at(padded, exponent)
    if fraction == "", do: integer, else: integer <> "." <> fraction
  end

  @doc """
  Parses a field: `nil` for an empty field, a boolean, a number in canonical form, or else the string itself.

      iex> Enum.map(["True", "12", "1.50", "NaN", "", "007", "x"], &Situ.Bridge.Format.Csv.Number.parse_field/1)
      [true, 12, 1.5, :nan, nil, "007", "x"]
  """
  @spec parse_field(String.t()) :: term()
  def parse_field(""), do: nil
  def parse_field(text) when text in ["True", "true"], do: true
  def parse_field(text) when text in ["False", "false"], do: false
  def parse_field("NaN"), do: :nan
  def parse_field(text) when text in ["Infinity", "∞"], do: :infinity
  def parse_field(text) when text in ["-Infinity", "-∞"], do: :neg_infinity

  def parse_field(text) do
    case Regex.run(@canonical, text) do
      [_, _] -> parse_integer(text)
      [_, _ | _] -> parse_float(text)
      nil -> text
    end
  end

  defp parse_integer(text) when byte_size(text) <= 400, do: String.to_integer(text)
  defp parse_integer(text), do: text

  defp parse_float(text) do
    case Float.parse(text) do
      {x, ""} -> x
      _ -> text
    end
  end
end
