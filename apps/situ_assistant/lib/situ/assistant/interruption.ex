defmodule Situ.Assistant.Interruption do
  @moduledoc false
  # Detects when a user interrupts the assistant. It triggers on the first words that are not the
  # assistant's own (`Situ.Assistant.EchoDetector`) and have lasted half a second. In shorter
  # audio, recognizers find words that nobody said.
  #
  # Inputs `:partial` and `:heard` contain recognized utterances (`Situ.Infer.Speech.Utterance`),
  # and `:said` contains the assistant's replies. Output `:out` emits the words once for each
  # utterance, at the time up to which they were heard.
  use Situ.Component,
    inputs: [
      partial: Situ.Infer.Speech.Utterance,
      heard: Situ.Infer.Speech.Utterance,
      said: :string
    ],
    outputs: [out: :string]

  alias Situ.Assistant.EchoDetector

  @enough 500_000_000

  @impl true
  def init(_opts), do: {:ok, %{echo: EchoDetector.new(), from: nil, last: nil}}

  @impl true
  def handle_message(:said, %{data: text, originating_time: time}, _context, state),
    do: {[], %{state | echo: EchoDetector.add_text(state.echo, time, text)}}

  def handle_message(_heard, %{data: utterance, originating_time: time}, _context, state) do
    again? = state.from != nil and utterance.from <= state.from
    early? = not utterance.final? and utterance.to - utterance.from < @enough

    if again? or early? or EchoDetector.own_words?(state.echo, utterance.from, utterance.text) do
      {[], state}
    else
      at = if state.last, do: max(time, state.last + 1), else: time
      {[{:out, at, utterance.text}], %{state | from: utterance.from, last: at}}
    end
  end
end
