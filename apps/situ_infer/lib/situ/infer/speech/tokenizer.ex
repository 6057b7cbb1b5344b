defmodule Situ.Infer.Speech.Tokenizer do
  @moduledoc false
  # The vocabulary of a recognizer, which maps token numbers to text.
  #
  # The file is a sequence of entries, each a length followed by that many bytes. A length of 128
  # or more takes two bytes, `(first - 128) + second * 128`. `▁` (U+2581) represents a space.
  import Situ.BinarySize, only: [pinned_size: 1]

  @type t :: tuple()

  @doc """
  Parses a vocabulary file.

      iex> {:ok, tokenizer} = Situ.Infer.Speech.Tokenizer.parse(<<0, 5, "▁go", 3, "ing">>)
      iex> Situ.Infer.Speech.Tokenizer.decode_tokens(tokenizer, [1, 2])
      "going"
      iex> Situ.Infer.Speech.Tokenizer.parse(<<9, "short">>)
      :error
  """
  @spec parse(binary()) :: {:ok, t()} | :error
  def parse(bytes), do: parse_entries(bytes, [])

  defp parse_entries(<<>>, tokens), do: {:ok, tokens |> Enum.reverse() |> List.to_tuple()}

  defp parse_entries(<<size, token::binary-size(size), rest::binary>>, tokens) when size < 128,
    do: parse_entries(rest, [token | tokens])

  defp parse_entries(<<low, high, rest::binary>>, tokens) when low >= 128 do
    size = low - 128 + high * 128

    case rest do
      <<token::binary-pinned_size(size), rest::binary>> -> parse_entries(rest, [token | tokens])
      _ -> :error
    end
  end

  defp parse_entries(_, _found), do: :error

  @doc "Decodes tokens to text; numbers outside the vocabulary and incomplete characters are skipped."
  @spec decode_tokens(t(), [non_neg_integer()]) :: String.t()
  def decode_tokens(tokenizer, tokens) do
    for(t <- tokens, t < tuple_size(tokenizer), into: "", do: elem(tokenizer, t))
    |> String.codepoints()
    |> Enum.filter(&String.valid?/1)
    |> Enum.join()
    |> String.replace("▁", " ")
    |> String.trim()
  end
end
