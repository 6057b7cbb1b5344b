defmodule Situ.Infer.Speech.PocketSphinx.OutputParser do
  @moduledoc false
  # Parses the output of PocketSphinx's programs: words with times, alternatives, keywords. Pure.

  # The programs report times in frames of 10 ms.
  @frame 10_000_000
  # Scores are logarithms to base 1.0001 in units of 1024; the program itself uses a scale of 20 for confidence.
  @scale 1024 * :math.log(1.0001) / 20
  # Sentences of a grammar score above this value per frame, and other speech below (in recordings: -6 and -13).
  @middle -9.5
  @width 1.5

  @type word :: %{
          required(:text) => String.t(),
          required(:from) => non_neg_integer(),
          required(:to) => non_neg_integer(),
          optional(:confidence) => float()
        }
  @type hypothesis :: %{
          words: [word()],
          text: String.t(),
          score: integer(),
          frames: non_neg_integer()
        }
  @type result :: %{
          text: String.t(),
          confidence: float(),
          words: [word()],
          alternatives: [%{text: String.t(), confidence: float()}]
        }

  @doc """
  Parses a line of `-hypseg`: words with times (ns), the total acoustic score, and the number of
  frames.

      iex> line = "sound S 0 T -10 A -8 L -2 0 -3 0 <sil> 20 -5 0 ten(2) 60 -2 0 <sil> 90"
      iex> Situ.Infer.Speech.PocketSphinx.OutputParser.parse_segments(line).words
      [%{text: "ten", from: 200_000_000, to: 600_000_000}]
  """
  @spec parse_segments(String.t()) :: hypothesis()
  def parse_segments(line) do
    case String.split(line) do
      [_, "S", _, "T", _, "A", score, "L", _ | rest] ->
        {words, frames} = parse_words(rest, [])
        text = Enum.map_join(words, " ", & &1.text)
        %{words: words, text: text, score: parse_integer(score), frames: frames}

      _ ->
        %{words: [], text: "", score: 0, frames: 0}
    end
  end

  # Each word has its start, two scores and the text; the start of the next word is its end.
  defp parse_words([from, _, _, word | [to | _] = rest], words) do
    case spoken_word(word) do
      nil ->
        parse_words(rest, words)

      text ->
        parse_words(rest, [%{text: text, from: frames_to_ns(from), to: frames_to_ns(to)} | words])
    end
  end

  defp parse_words([frames | _], words), do: {Enum.reverse(words), parse_integer(frames)}
  defp parse_words([], words), do: {Enum.reverse(words), 0}

  # Silence, noise and grammar markers are not words; `ten(2)` is an alternative pronunciation of `ten`.
  defp spoken_word(<<first, _::binary>>) when first in ~c"<([+", do: nil
  defp spoken_word(word), do: word |> String.split("(") |> hd()

  defp frames_to_ns(frames), do: parse_integer(frames) * @frame

  defp parse_integer(text) do
    case Integer.parse(text) do
      {n, _} -> n
      :error -> 0
    end
  end

  @doc """
  Parses the lines of an n-best list: texts with their best scores, best first.

      iex> Situ.Infer.Speech.PocketSphinx.OutputParser.parse_alternatives("two four -7\\nfour -3\\nfour -9\\n")
      [{"four", -3}, {"two four", -7}]
  """
  @spec parse_alternatives(String.t()) :: [{String.t(), integer()}]
  def parse_alternatives(text) do
    text
    |> String.split("\n", trim: true)
    |> Enum.flat_map(fn line ->
      case line |> String.split() |> List.pop_at(-1) do
        {score, [_ | _] = words} -> [{Enum.join(words, " "), parse_integer(score)}]
        _ -> []
      end
    end)
    |> Enum.sort_by(fn {_, score} -> -score end)
    |> Enum.uniq_by(&elem(&1, 0))
  end

  @doc "Returns a confidence of 0..1 from the likelihood of the words relative to that of the free phone sequence."
  @spec phone_confidence(hypothesis(), hypothesis()) :: float()
  def phone_confidence(%{frames: frames} = hypothesis, phones) when frames > 0 do
    difference = (hypothesis.score - phones.score) / frames
    Situ.Infer.Activation.sigmoid((difference - @middle) / @width)
  end

  def phone_confidence(_said, _phones), do: 0.0

  @doc "Returns the weight of the recognized sentence relative to all alternatives, 0..1."
  @spec result_share(hypothesis(), [{String.t(), integer()}]) :: float()
  def result_share(hypothesis, others) do
    best = for {_, score} <- others, reduce: nil, do: (most -> max(score, most || score))

    weights = for {text, score} <- others, do: {text, score_weight(score, best)}
    all = weights |> Enum.map(&elem(&1, 1)) |> Enum.sum()
    own = Enum.find_value(weights, 0.0, fn {text, w} -> text == hypothesis.text && w end)

    # A sentence that is missing from its own list of alternatives was found in another pass of the recognizer.
    if own > 0, do: own / all, else: 1 / (1 + all)
  end

  defp score_weight(score, best), do: :math.exp(max((score - best) * @scale, -500.0))

  @doc "Builds the recognizer's result with at most `most` alternatives, weighted by their scores relative to the best."
  @spec build_result(hypothesis(), [{String.t(), integer()}], float(), non_neg_integer()) ::
          result()
  def build_result(hypothesis, others, confidence, most) do
    top = Enum.find_value(others, fn {text, score} -> text == hypothesis.text && score end)
    top = top || others |> Enum.map(&elem(&1, 1)) |> Enum.max(fn -> 0 end)

    alternatives =
      for {text, score} <- others,
          text != hypothesis.text,
          do: %{text: text, confidence: confidence * min(score_weight(score, top), 1.0)}

    %{
      text: hypothesis.text,
      confidence: confidence,
      words: hypothesis.words,
      alternatives: Enum.take(alternatives, most)
    }
  end

  @doc """
  Parses the output of the keyword search: the phrase, followed by a line with the times of each occurrence.

      iex> output = "forward \\nforward 0.630 1.210 0.93\\n"
      iex> heard = Situ.Infer.Speech.PocketSphinx.OutputParser.parse_keyword_output(output)
      iex> {heard.text, heard.confidence, heard.words}
      {"forward", 0.93, [%{text: "forward", from: 630_000_000, to: 1_210_000_000, confidence: 0.93}]}
  """
  @spec parse_keyword_output(String.t()) :: result()
  def parse_keyword_output(output) do
    words =
      for line <- String.split(output, "\n"),
          [_, phrase, from, to, p] <-
            [Regex.run(~r/^(.+?) ([\d.]+) ([\d.]+) ([\d.]+)$/, String.trim(line))],
          do: %{
            text: phrase,
            from: seconds_to_ns(from),
            to: seconds_to_ns(to),
            confidence: min(parse_float(p), 1.0)
          }

    %{
      text: Enum.map_join(words, " ", & &1.text),
      confidence: words |> Enum.map(& &1.confidence) |> Enum.max(fn -> 0.0 end),
      words: words,
      alternatives: []
    }
  end

  defp seconds_to_ns(text), do: round(parse_float(text) * 1.0e9)

  defp parse_float(text) do
    case Float.parse(text) do
      {n, _} -> n
      :error -> 0.0
    end
  end
end
