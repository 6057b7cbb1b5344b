defmodule Situ.Build.Limits do
  @moduledoc false
  # Limits for the measurements of names and English. A change may lower a limit but never raise
  # it.
  #
  # Each limit is the measured value, rounded up, from the day when the limit was last lowered. A
  # change that exceeds a limit breaks the build. A change that improves a value should lower its
  # limit here.
  alias Situ.Build.{English, Names}

  @limits %{
    one_word_private: 3.4,
    one_word_public: 32.0,
    participles: 0,
    paths: 0,
    repeated_words: 0,
    english: 0.7
  }
  @least_mean_letters 11.3

  @doc "Returns one sentence for each limit that the checkout at `root` exceeds."
  @spec find_violations(Path.t()) :: [String.t()]
  def find_violations(root) do
    find_exceeded(Names.measure(root), English.measure(root), @limits, @least_mean_letters)
  end

  @doc """
  Compares measured figures with limits.

      iex> names = %{one_word_private: 21.0, one_word_public: 0.0, mean_letters: 12.0, participles: [], paths: [],
      ...>   repeated_words: []}
      iex> limits = %{one_word_private: 20.0, one_word_public: 40.0, participles: 0, paths: 0, repeated_words: 0,
      ...>   english: 2.0}
      iex> Situ.Build.Limits.find_exceeded(names, 1.9, limits, 11.0)
      ["21.0 % of private functions have a name of one word; the limit is 20.0 %"]
  """
  @spec find_exceeded(Names.t(), float(), map(), float()) :: [String.t()]
  def find_exceeded(names, english, limits, least_letters) do
    share_problem("private", names.one_word_private, limits.one_word_private) ++
      share_problem("public", names.one_word_public, limits.one_word_public) ++
      letters_problem(names.mean_letters, least_letters) ++
      places_problem("function named by a participle", names.participles, limits.participles) ++
      places_problem("file whose path differs from its module's name", names.paths, limits.paths) ++
      places_problem(
        "last two words of a name that several modules share",
        names.repeated_words,
        limits.repeated_words
      ) ++
      sentences_problem(english, limits.english)
  end

  defp share_problem(kind, value, limit) when value > limit,
    do: [
      "#{round_up(value)} % of #{kind} functions have a name of one word; the limit is #{limit} %"
    ]

  defp share_problem(_kind, _value, _limit), do: []

  defp letters_problem(value, least) when value < least,
    do: [
      "names of functions have #{Float.round(value, 1)} letters on average; the limit is #{least}"
    ]

  defp letters_problem(_value, _least), do: []

  defp places_problem(problem, found, limit) when length(found) > limit,
    do: ["#{length(found)} times: #{problem}; the limit is #{limit}: #{Enum.join(found, "; ")}"]

  defp places_problem(_problem, _found, _limit), do: []

  defp sentences_problem(value, limit) when value > limit,
    do: [
      "#{round_up(value)} habits of unclear English per 1,000 words (Situ.Build.English); the limit is #{limit}"
    ]

  defp sentences_problem(_value, _limit), do: []

  defp round_up(value), do: Float.ceil(value, 1)
end
