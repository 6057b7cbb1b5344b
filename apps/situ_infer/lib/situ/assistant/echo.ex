defmodule Situ.Assistant.Echo do
  @moduledoc """
  Whether somebody said something, or the microphone heard the assistant itself: words that it was just saying are its
  own. Pure.

      iex> echo = Situ.Assistant.Echo.new() |> Situ.Assistant.Echo.said(0, "The timer is set for five minutes.")
      iex> Situ.Assistant.Echo.own?(echo, 1_000_000_000, "timer set for five minutes")
      true
      iex> Situ.Assistant.Echo.own?(echo, 1_000_000_000, "computer, stop")
      false
      iex> Situ.Assistant.Echo.own?(echo, 10_000_000_000, "timer set for five minutes")
      false
  """
  alias Situ.Infer.Speech.Utterance

  # About as long as a letter takes slow voices, and what speakers, rooms and microphones add.
  @letter 90_000_000
  @delay 1_000_000_000
  # A recogniser gets some words of an echo wrong.
  @share 0.6

  defstruct said: []
  @type t :: %__MODULE__{said: [{until :: Situ.Time.t(), MapSet.t()}]}

  @doc "Nothing was said."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "The assistant says this at `time`, or after what it was saying."
  @spec said(t(), Situ.Time.t(), String.t()) :: t()
  def said(%__MODULE__{said: said} = echo, time, text) do
    begins = Enum.reduce(said, time, fn {until, _}, begins -> max(begins, until - @delay) end)
    until = begins + @letter * String.length(text) + @delay
    kept = Enum.filter(said, fn {until, _} -> until >= time end)
    %{echo | said: [{until, MapSet.new(Utterance.words(text))} | kept]}
  end

  @doc "Whether what was heard from `from` on is what the assistant was saying then."
  @spec own?(t(), Situ.Time.t(), String.t()) :: boolean()
  def own?(%__MODULE__{said: said}, from, text) do
    words = Utterance.words(text)

    words != [] and
      Enum.any?(said, fn {until, own} ->
        from <= until and Enum.count(words, &(&1 in own)) / length(words) >= @share
      end)
  end
end
