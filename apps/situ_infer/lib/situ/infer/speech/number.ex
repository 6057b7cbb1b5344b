defmodule Situ.Infer.Speech.Number do
  @moduledoc false
  # Parses and formats English numbers from 0 to 999, in words or digits.
  @small ~w(zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen
            seventeen eighteen nineteen)
  @tens ~w(twenty thirty forty fifty sixty seventy eighty ninety)
  @units @small |> Enum.with_index() |> Map.new()
  @tens_of @tens |> Enum.with_index(2) |> Map.new(fn {word, n} -> {word, 10 * n} end)

  @doc """
  Returns the numbers at the start of a list of words as `{word count, value}`, longest first.

      iex> Situ.Infer.Speech.Number.parse_prefixes(["twenty", "five", "minutes"])
      [{2, 25}, {1, 20}]
      iex> Situ.Infer.Speech.Number.to_words(305)
      "three hundred and five"
  """
  @spec parse_prefixes([String.t()]) :: [{pos_integer(), 0..999}]
  def parse_prefixes(words) do
    for n <- 5..1//-1,
        n <= length(words),
        value = words |> Enum.take(n) |> parse_number(),
        do: {n, value}
  end

  defp parse_number([word]) when is_map_key(@units, word), do: @units[word]
  defp parse_number([word]) when is_map_key(@tens_of, word), do: @tens_of[word]
  defp parse_number([word]) when word in ["a", "an"], do: nil
  defp parse_number([digits]), do: if(digits =~ ~r/\A[0-9]{1,3}\z/, do: String.to_integer(digits))

  defp parse_number([tens, unit]) when is_map_key(@tens_of, tens) and is_map_key(@units, unit) do
    if @units[unit] in 1..9, do: @tens_of[tens] + @units[unit]
  end

  defp parse_number(["a", "hundred" | rest]), do: parse_hundreds(1, rest)

  defp parse_number([unit, "hundred" | rest]) when is_map_key(@units, unit),
    do: if(@units[unit] in 1..9, do: parse_hundreds(@units[unit], rest))

  defp parse_number(_), do: nil

  defp parse_hundreds(n, []), do: 100 * n
  defp parse_hundreds(n, ["and" | rest]) when rest != [], do: parse_hundreds(n, rest)

  defp parse_hundreds(n, rest) do
    case parse_number(rest) do
      more when more in 1..99 -> 100 * n + more
      _ -> nil
    end
  end

  @doc "Formats a number in words, for speech output."
  @spec to_words(0..999) :: String.t()
  def to_words(n) when n < 20, do: Enum.at(@small, n)
  def to_words(n) when n < 100 and rem(n, 10) == 0, do: Enum.at(@tens, div(n, 10) - 2)
  def to_words(n) when n < 100, do: to_words(n - rem(n, 10)) <> " " <> to_words(rem(n, 10))
  def to_words(n) when rem(n, 100) == 0, do: to_words(div(n, 100)) <> " hundred"

  def to_words(n) when n < 1000,
    do: to_words(div(n, 100)) <> " hundred and " <> to_words(rem(n, 100))
end
