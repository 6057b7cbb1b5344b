defmodule Situ.Bridge.Format.Csv.Number do
  @moduledoc false
  # Formats numbers as .NET's invariant culture does, and parses fields into values.
  import Situ.Bits, only: [known: 1]

  @canonical ~r/\A-?(0|[1-9]\d*)(\.\d+)?([eE][+-]?\d{1,3})?\z/

  @doc """
  Returns the shortest digits that represent the number, without ".0", and with an exponent from 1E+15 on and below
  0.0001.

      iex> Enum.map([1.0, 0.1, 1.5e20, 1.0e-5, -0.0, 12], &Situ.Bridge.Format.Csv.Number.write/1)
      ["1", "0.1", "1.5E+20", "1E-05", "-0", "12"]
  """
  @spec write(number() | atom()) :: String.t()
  def write(n) when is_integer(n), do: Integer.to_string(n)
  def write(:nan), do: "NaN"
  def write(:infinity), do: "Infinity"
  def write(:neg_infinity), do: "-Infinity"

  def write(x) when is_float(x) do
    text = :erlang.float_to_binary(x, [:short])

    if abs(x) < 0.0001 or abs(x) >= 1.0e15 or :binary.match(text, "e") != :nomatch do
      {sign, digits, exponent} = digits(text)
      sign <> place(digits, exponent)
    else
      whole(text)
    end
  end

  # Without an exponent, only a final ".0" has to be removed.
  defp whole(text) do
    size = byte_size(text) - 2

    case text do
      <<whole::binary-known(size), ".0">> -> whole
      _ -> text
    end
  end

  # Returns the sign, the digits d and the exponent e of 0.ddd * 10^e.
  defp digits(text) do
    text = if String.contains?(text, "e"), do: text, else: text <> "e0"
    [mantissa, exponent] = String.split(text, "e")

    {sign, mantissa} =
      if String.starts_with?(mantissa, "-"),
        do: {"-", String.slice(mantissa, 1..-1//1)},
        else: {"", mantissa}

    [whole, fraction] = String.split(mantissa <> ".", ".") |> Enum.take(2)
    digits = whole <> fraction
    trimmed = String.trim_leading(digits, "0")
    moved = byte_size(whole) - (byte_size(digits) - byte_size(trimmed))
    {sign, trimmed |> String.trim_trailing("0") |> or_zero(), String.to_integer(exponent) + moved}
  end

  defp or_zero(""), do: "0"
  defp or_zero(digits), do: digits

  defp place("0", _exponent), do: "0"

  defp place(digits, exponent) when exponent > 15 or exponent < -3 do
    {first, rest} = String.split_at(digits, 1)
    fraction = if rest == "", do: "", else: "." <> rest
    power = exponent - 1
    sign = if power < 0, do: "-", else: "+"

    "#{first}#{fraction}E#{sign}#{power |> abs() |> Integer.to_string() |> String.pad_leading(2, "0")}"
  end

  defp place(digits, exponent) when exponent <= 0,
    do: "0." <> String.duplicate("0", -exponent) <> digits

  defp place(digits, exponent) do
    padded = String.pad_trailing(digits, exponent, "0")
    {whole, fraction} = String.split_at(padded, exponent)
    if fraction == "", do: whole, else: whole <> "." <> fraction
  end

  @doc """
  Parses a field: `nil` for an empty field, a boolean, a number in canonical form, or else the string itself.

      iex> Enum.map(["True", "12", "1.50", "NaN", "", "007", "x"], &Situ.Bridge.Format.Csv.Number.read/1)
      [true, 12, 1.5, :nan, nil, "007", "x"]
  """
  @spec read(String.t()) :: term()
  def read(""), do: nil
  def read(text) when text in ["True", "true"], do: true
  def read(text) when text in ["False", "false"], do: false
  def read("NaN"), do: :nan
  def read(text) when text in ["Infinity", "∞"], do: :infinity
  def read(text) when text in ["-Infinity", "-∞"], do: :neg_infinity

  def read(text) do
    case Regex.run(@canonical, text) do
      [_, _] -> integer(text)
      [_, _ | _] -> float(text)
      nil -> text
    end
  end

  defp integer(text) when byte_size(text) <= 400, do: String.to_integer(text)
  defp integer(text), do: text

  defp float(text) do
    case Float.parse(text) do
      {x, ""} -> x
      _ -> text
    end
  end
end
