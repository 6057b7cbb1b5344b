defmodule Situ.Intent.Number do
  @moduledoc """
  Parses and formats English numbers from 0 to 999, in words or digits.

      iex> Situ.Intent.Number.prefixes(["twenty", "five", "minutes"])
      [{2, 25}, {1, 20}]
      iex> Situ.Intent.Number.words(305)
      "three hundred and five"
  """
  @small ~w(zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen
            seventeen eighteen nineteen)
  @tens ~w(twenty thirty forty fifty sixty seventy eighty ninety)
  @units @small |> Enum.with_index() |> Map.new()
  @tens_of @tens |> Enum.with_index(2) |> Map.new(fn {word, n} -> {word, 10 * n} end)

  @doc "Returns the numbers at the start of a list of words as `{word count, value}`, longest first."
  @spec prefixes([String.t()]) :: [{pos_integer(), 0..999}]
  def prefixes(words) do
    for n <- 5..1//-1,
        n <= length(words),
        value = words |> Enum.take(n) |> value(),
        do: {n, value}
  end

  defp value([word]) when is_map_key(@units, word), do: @units[word]
  defp value([word]) when is_map_key(@tens_of, word), do: @tens_of[word]
  defp value([word]) when word in ["a", "an"], do: nil
  defp value([digits]), do: if(digits =~ ~r/\A[0-9]{1,3}\z/, do: String.to_integer(digits))

  defp value([tens, unit]) when is_map_key(@tens_of, tens) and is_map_key(@units, unit) do
    if @units[unit] in 1..9, do: @tens_of[tens] + @units[unit]
  end

  defp value(["a", "hundred" | rest]), do: hundreds(1, rest)

  defp value([unit, "hundred" | rest]) when is_map_key(@units, unit),
    do: if(@units[unit] in 1..9, do: hundreds(@units[unit], rest))

  defp value(_), do: nil

  defp hundreds(n, []), do: 100 * n
  defp hundreds(n, ["and" | rest]) when rest != [], do: hundreds(n, rest)

  defp hundreds(n, rest) do
    case value(rest) do
      more when more in 1..99 -> 100 * n + more
      _ -> nil
    end
  end

  @doc "Formats a number in words, for speech output."
  @spec words(0..999) :: String.t()
  def words(n) when n < 20, do: Enum.at(@small, n)
  def words(n) when n < 100 and rem(n, 10) == 0, do: Enum.at(@tens, div(n, 10) - 2)
  def words(n) when n < 100, do: words(n - rem(n, 10)) <> " " <> words(rem(n, 10))
  def words(n) when rem(n, 100) == 0, do: words(div(n, 100)) <> " hundred"
  def words(n) when n < 1000, do: words(div(n, 100)) <> " hundred and " <> words(rem(n, 100))
end
