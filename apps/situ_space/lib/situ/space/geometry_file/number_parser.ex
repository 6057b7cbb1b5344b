defmodule Situ.Space.GeometryFile.NumberParser do
  @moduledoc false
  # Parses numbers in text files.

  # Elixir's own parser raises if a number has hundreds of digits and is too large for a float.
  @most 200

  @typedoc "An IEEE 754 number."
  @type ieee_number :: float() | :nan | :infinity | :neg_infinity

  @doc """
  Parses a finite number, with or without a fraction, with nothing after it.

      iex> Situ.Space.GeometryFile.NumberParser.parse_float("1e-3")
      {:ok, 0.001}
      iex> for text <- [".5", "-1.", "2.e3"], do: elem(Situ.Space.GeometryFile.NumberParser.parse_float(text), 1)
      [0.5, -1.0, 2.0e3]
      iex> texts = [String.duplicate("9", 400), "1e400", "nan"]
      iex> Enum.map(texts, &Situ.Space.GeometryFile.NumberParser.parse_float/1)
      [:error, :error, :error]
  """
  @spec parse_float(String.t()) :: {:ok, float()} | :error
  def parse_float(text) do
    with {:ok, x} when is_atom(x) <- parse_number(text), do: :error
  end

  @doc """
  Parses a number like C's `strtod`: a number too large for 64 bits is infinite, and "nan" and "inf" are numbers.

      iex> texts = ["1.5", "-1e400", "NaN", "inf", "1e-400", "1e", ""]
      iex> Enum.map(texts, &Situ.Space.GeometryFile.NumberParser.parse_number/1)
      [{:ok, 1.5}, {:ok, :neg_infinity}, {:ok, :nan}, {:ok, :infinity}, {:ok, 0.0}, :error, :error]
  """
  @spec parse_number(String.t()) :: {:ok, ieee_number()} | :error
  def parse_number(text) when byte_size(text) <= @most do
    case Float.parse(text) do
      {x, ""} -> {:ok, x}
      _ -> parse_other(text)
    end
  end

  def parse_number(_text), do: :error

  @doc """
  Parses a coordinate, which must be finite in 32 bits. Throws `{:bad, why}` if it is invalid.

      iex> Situ.Space.GeometryFile.NumberParser.parse_coordinate!("-1.5")
      -1.5
      iex> catch_throw(Situ.Space.GeometryFile.NumberParser.parse_coordinate!("x"))
      {:bad, ~s("x" is not a number)}
  """
  @spec parse_coordinate!(String.t()) :: float()
  def parse_coordinate!(word) do
    case parse_number(word) do
      {:ok, x} when is_float(x) and abs(x) < 3.4e38 ->
        x

      {:ok, _} ->
        throw({:bad, "a vertex is at #{shorten_word(word)}, which is not finite in 32 bits"})

      :error ->
        throw_no_number(word)
    end
  end

  @doc "Throws `{:bad, why}` for a word that is not a number."
  @spec throw_no_number(String.t()) :: no_return()
  def throw_no_number(word), do: throw({:bad, "#{inspect(shorten_word(word))} is not a number"})

  defp shorten_word(word), do: String.slice(word, 0, 40)

  # Many programs omit the zero before or after the decimal point, which Elixir's parser rejects.
  defp parse_other(text) do
    case Regex.run(~r/\A([+-]?)(\d*)(?:\.(\d*))?([eE][+-]?\d+)?\z/, text) do
      [_, sign, whole | rest] ->
        {part, exponent} = {Enum.at(rest, 0, ""), Enum.at(rest, 1, "")}
        if whole <> part == "", do: :error, else: {:ok, parse_whole(sign, whole, part, exponent)}

      nil ->
        parse_word(String.downcase(text))
    end
  end

  # The text has the form of a number, so parsing fails only if the number is too large.
  defp parse_whole(sign, whole, part, exponent) do
    case Float.parse("#{sign}#{zero_if_empty(whole)}.#{zero_if_empty(part)}#{exponent}") do
      {x, ""} -> x
      _ -> if sign == "-", do: :neg_infinity, else: :infinity
    end
  end

  defp parse_word(word) when word in ["nan", "+nan", "-nan"], do: {:ok, :nan}

  defp parse_word(word) when word in ["inf", "+inf", "infinity", "+infinity"],
    do: {:ok, :infinity}

  defp parse_word(word) when word in ["-inf", "-infinity"], do: {:ok, :neg_infinity}
  defp parse_word(_word), do: :error

  defp zero_if_empty(""), do: "0"
  defp zero_if_empty(digits), do: digits
end
