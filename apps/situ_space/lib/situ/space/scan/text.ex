defmodule Situ.Space.Scan.Text do
  @moduledoc false
  # Numbers as files write them.

  # Elixir's own parser raises where a number of hundreds of digits is no float.
  @most 200

  @typedoc "A number as IEEE 754 has it."
  @type number_or_none :: float() | :nan | :infinity | :neg_infinity

  @doc """
  Parses a finite number, whole or not, with nothing after it.

      iex> Situ.Space.Scan.Text.float("1e-3")
      {:ok, 0.001}
      iex> for text <- [".5", "-1.", "2.e3"], do: elem(Situ.Space.Scan.Text.float(text), 1)
      [0.5, -1.0, 2.0e3]
      iex> for text <- [String.duplicate("9", 400), "1e400", "nan"], do: Situ.Space.Scan.Text.float(text)
      [:error, :error, :error]
  """
  @spec float(String.t()) :: {:ok, float()} | :error
  def float(text) do
    with {:ok, x} when is_atom(x) <- number(text), do: :error
  end

  @doc """
  Parses a number as C's `strtod` does: one too large for 64 bits is infinite, and "nan" and "inf" are numbers.

      iex> for text <- ["1.5", "-1e400", "NaN", "inf", "1e-400", "1e", ""], do: Situ.Space.Scan.Text.number(text)
      [{:ok, 1.5}, {:ok, :neg_infinity}, {:ok, :nan}, {:ok, :infinity}, {:ok, 0.0}, :error, :error]
  """
  @spec number(String.t()) :: {:ok, number_or_none()} | :error
  def number(text) when byte_size(text) <= @most do
    case Float.parse(text) do
      {x, ""} -> {:ok, x}
      _ -> parse_other(text)
    end
  end

  def number(_text), do: :error

  # Many write a number without the zero before its point, or behind it; Elixir's parser knows none such.
  defp parse_other(text) do
    case Regex.run(~r/\A([+-]?)(\d*)(?:\.(\d*))?([eE][+-]?\d+)?\z/, text) do
      [_, sign, whole | rest] ->
        {part, exponent} = {Enum.at(rest, 0, ""), Enum.at(rest, 1, "")}
        if whole <> part == "", do: :error, else: {:ok, parse_whole(sign, whole, part, exponent)}

      nil ->
        parse_word(String.downcase(text))
    end
  end

  # Of what has the form of a number, only one that is too large is none.
  defp parse_whole(sign, whole, part, exponent) do
    case Float.parse("#{sign}#{zero(whole)}.#{zero(part)}#{exponent}") do
      {x, ""} -> x
      _ -> if sign == "-", do: :neg_infinity, else: :infinity
    end
  end

  defp parse_word(word) when word in ["nan", "+nan", "-nan"], do: {:ok, :nan}

  defp parse_word(word) when word in ["inf", "+inf", "infinity", "+infinity"],
    do: {:ok, :infinity}

  defp parse_word(word) when word in ["-inf", "-infinity"], do: {:ok, :neg_infinity}
  defp parse_word(_word), do: :error

  defp zero(""), do: "0"
  defp zero(digits), do: digits
end
