defmodule Situ.Assistant.EchoDetector do
  @moduledoc false
  # Distinguishes a user's speech from the assistant's own voice in the microphone. Words that the
  # assistant is currently speaking count as its own. Pure.
  alias Situ.Infer.Speech.Utterance

  # The time that a slow voice takes per letter, and the delay that speakers, rooms and microphones add.
  @letter 90_000_000
  @delay 1_000_000_000
  # The share of matching words is below 1 because a recognizer gets some words of an echo wrong.
  @share 0.6

  defstruct texts: []
  @type t :: %__MODULE__{texts: [{until :: Situ.Time.t(), MapSet.t()}]}

  @doc """
  Returns an empty echo memory.

      iex> echo = Situ.Assistant.EchoDetector.new()
      iex> echo = Situ.Assistant.EchoDetector.add_text(echo, 0, "The timer is set for five minutes.")
      iex> Situ.Assistant.EchoDetector.own_words?(echo, 1_000_000_000, "timer set for five minutes")
      true
      iex> Situ.Assistant.EchoDetector.own_words?(echo, 1_000_000_000, "computer, stop")
      false
      iex> Situ.Assistant.EchoDetector.own_words?(echo, 10_000_000_000, "timer set for five minutes")
      false
  """
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Adds a text that the assistant speaks at `time`, or after the texts it is already speaking."
  @spec add_text(t(), Situ.Time.t(), String.t()) :: t()
  def add_text(%__MODULE__{texts: texts} = echo, time, text) do
    begins = Enum.reduce(texts, time, fn {until, _}, begins -> max(begins, until - @delay) end)
    until = begins + @letter * String.length(text) + @delay
    recent = Enum.filter(texts, fn {until, _} -> until >= time end)
    %{echo | texts: [{until, MapSet.new(Utterance.normalize_words(text))} | recent]}
  end

  @doc "Returns whether the text heard at `from` consists mostly of words that the assistant was speaking then."
  @spec own_words?(t(), Situ.Time.t(), String.t()) :: boolean()
  def own_words?(%__MODULE__{texts: texts}, from, text) do
    words = Utterance.normalize_words(text)

    words != [] and
      Enum.any?(texts, fn {until, own} ->
        from <= until and Enum.count(words, &(&1 in own)) / length(words) >= @share
      end)
  end
end
