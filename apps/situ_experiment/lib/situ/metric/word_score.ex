defmodule Situ.Metric.WordScore do
  @moduledoc false
  # Compares recognized words with the true ones: the word error rate is the least number of substitutions, deletions
  # and insertions that turn the true words into the recognized ones, per true word (V. I. Levenshtein, 1966).
  @behaviour Situ.Metric.Measure

  alias Situ.Metric.Ratio

  @impl true
  def directions, do: %{"wer" => :lower}

  @doc """
  Counts the words and errors of one text.

      iex> Situ.Metric.WordScore.count_errors("the cat sat", "a cat sat down")
      %{"words" => 3, "errors" => 2}
  """
  @spec count_errors(String.t(), String.t()) :: %{String.t() => non_neg_integer()}
  def count_errors(truth, output) do
    {truth, output} = {String.split(truth), String.split(output)}
    %{"words" => length(truth), "errors" => edit_distance(truth, output)}
  end

  @doc """
  Lowers a text's case and removes its punctuation, except apostrophes within words.

      iex> Situ.Metric.WordScore.normalize_text("Don't stop, PLEASE!")
      "don't stop please"
  """
  @spec normalize_text(String.t()) :: String.t()
  def normalize_text(text) do
    text
    |> String.downcase()
    |> String.replace("\u2019", "'")
    |> String.replace(~r/[^\p{L}\p{N}'\s]+/u, " ")
    |> String.split()
    |> Enum.join(" ")
  end

  @impl true
  def compute_values(counts), do: %{"wer" => Ratio.divide(counts["errors"], counts["words"])}

  @doc """
  Returns the least cost of substitutions, deletions and insertions that turn one list into the other. A deletion or an
  insertion costs 1, and `substitution` returns the cost of two items; 2 or more means that they are not counterparts.

      iex> Situ.Metric.WordScore.edit_distance(~w(the cat sat), ~w(a cat))
      2
  """
  @spec edit_distance([item], [item], (item, item -> non_neg_integer())) :: non_neg_integer()
        when item: term()
  def edit_distance(truth, output, substitution \\ &word_cost/2) do
    first_row = Enum.to_list(0..length(output))

    truth
    |> Enum.with_index(1)
    |> Enum.reduce(first_row, fn {word, n}, row ->
      next_row(row, {word, n}, output, substitution)
    end)
    |> List.last()
  end

  defp word_cost(word, word), do: 0
  defp word_cost(_word, _other), do: 1

  defp next_row(row, {word, n}, output, substitution) do
    {cells, _} =
      [row, tl(row), output]
      |> Enum.zip()
      |> Enum.map_reduce(n, fn {diagonal, above, other}, left ->
        cell = Enum.min([diagonal + substitution.(word, other), above + 1, left + 1])
        {cell, cell}
      end)

    [n | cells]
  end
end
