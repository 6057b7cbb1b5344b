defmodule Situ.Metric.SpeakerWordScore do
  @moduledoc false
  # Compares who said which words with the truth. Speakers of the output have other names, so each is compared with the
  # true speaker that gives the least errors in total (concatenated minimum-permutation word error rate, cpWER; S.
  # Watanabe et al., CHiME-6, 2020). A speaker without a counterpart counts with all words.
  #
  # The time-constrained rate (tcpWER; T. von Neumann et al., 2023) also needs the time of a word to be right: a word
  # only counts as recognized, or as substituted, if its time in the output is at most the collar away from the true
  # word. Utterances have times, words do not: they divide an utterance in proportion to their letters. In the output, a
  # word is at the middle of its part.
  @behaviour Situ.Metric.Measure

  alias Situ.Metric.{Assignment, Ratio, WordScore}

  @type utterance :: {speaker :: String.t(), Situ.Time.t(), Situ.Time.t(), text :: String.t()}

  @impl true
  def directions, do: %{"cpwer" => :lower, "tcpwer" => :lower}

  @doc """
  Counts the true words and the errors of one session; `collar` is in ns.

      iex> truth = [{"Ada", 0, 10, "good morning"}, {"Ben", 10, 20, "hello"}]
      iex> output = [{"1", 10, 20, "hello"}, {"2", 0, 10, "good evening"}]
      iex> Situ.Metric.SpeakerWordScore.count_errors(truth, output, 5)
      %{"words" => 3, "cp_errors" => 1, "tcp_errors" => 1}
      iex> Situ.Metric.SpeakerWordScore.count_errors([{"Ada", 0, 10, "yes"}], [{"1", 50, 60, "yes"}], 5)
      %{"words" => 1, "cp_errors" => 0, "tcp_errors" => 2}
  """
  @spec count_errors([utterance()], [utterance()], Situ.Time.duration()) :: %{
          String.t() => non_neg_integer()
        }
  def count_errors(truth, output, collar) do
    {truth, output} = {group_words(truth), group_words(output)}
    words = for speaker <- truth, do: length(speaker)

    %{
      "words" => Enum.sum(words),
      "cp_errors" => least_errors(truth, output, &same_word/2),
      "tcp_errors" => least_errors(truth, output, &near_word(&1, &2, collar))
    }
  end

  @impl true
  def compute_values(counts) do
    %{
      "cpwer" => Ratio.divide(counts["cp_errors"], counts["words"]),
      "tcpwer" => Ratio.divide(counts["tcp_errors"], counts["words"])
    }
  end

  # The words of each speaker, with the interval of each.
  defp group_words(utterances) do
    utterances
    |> Enum.sort_by(fn {_, from, _, _} -> from end)
    |> Enum.group_by(&elem(&1, 0), &split_utterance/1)
    |> Enum.map(fn {_, words} -> Enum.concat(words) end)
  end

  defp split_utterance({_, from, to, text}) do
    words = String.split(text)
    lengths = Enum.map(words, &String.length/1)
    letter = (to - from) / max(Enum.sum(lengths), 1)

    lengths
    |> Enum.scan(&(&1 + &2))
    |> Enum.zip(Enum.zip(words, lengths))
    |> Enum.map(fn {last, {word, n}} ->
      {word, from + letter * (last - n), from + letter * last}
    end)
  end

  defp least_errors(truth, output, cost) do
    n = max(length(truth), length(output))
    output = add_silent(output, n)

    costs =
      for a <- add_silent(truth, n), do: for(b <- output, do: WordScore.edit_distance(a, b, cost))

    Enum.sum(for {i, j} <- Assignment.pair_rows(costs), do: costs |> Enum.at(i) |> Enum.at(j))
  end

  defp add_silent(speakers, n), do: speakers ++ List.duplicate([], n - length(speakers))

  defp same_word({word, _, _}, {word, _, _}), do: 0
  defp same_word(_, _), do: 1

  # Two words at different times are a deletion and an insertion.
  defp near_word({truth, from, to}, {output, a, b}, collar) do
    middle = (a + b) / 2

    cond do
      not (from < middle + collar and to > middle - collar) -> 2
      truth == output -> 0
      true -> 1
    end
  end
end
