defmodule Situ.Intent.Detector do
  @moduledoc """
  Detects intents in a stream of texts or recognized utterances.

      heard = Situ.Infer.transcribe(sound)
      wanted = Situ.via(heard, Situ.Intent.Detector, recognizer_options: [grammar: "room.gram"])

  Input `:in` is a string or a `Situ.Infer.Speech.Utterance`. Output `:out` is a `Situ.Intent` for each, at its time;
  its intents are empty if nothing matches. A message on the input `:options` (a keyword list, such as
  `[grammar: other]`) changes the recognizer's options at run time, effective from its originating time. Invalid options
  raise an error, and the old options remain in effect.
  """

  @schema [
    recognizer: [
      type: :module,
      default: Situ.Intent.Grammar,
      doc: "The module that detects intents, a `Situ.Intent.Recognizer`."
    ],
    recognizer_options: [
      type: :keyword,
      required: true,
      doc: "Options for its `load/1`, such as `[grammar: ...]`."
    ]
  ]

  use Situ.Component,
    inputs: [in: :any, options: {:any, optional: true}],
    outputs: [out: Situ.Intent],
    options: @schema

  alias Situ.Error
  alias Situ.Infer.Speech.Utterance

  @impl true
  def init(opts) do
    with {:ok, recognizer} <- opts[:recognizer].load(opts[:recognizer_options]),
         do: {:ok, %{opts: Map.new(opts), recognizer: recognizer}}
  end

  @impl true
  def handle_message(:in, %{data: sentence, originating_time: time}, _context, state) do
    intent =
      Error.unwrap!(state.opts.recognizer.detect(state.recognizer, sentence_text(sentence)))

    {[{:out, time, intent}], state}
  end

  def handle_message(:options, %{data: changes}, _context, %{opts: opts} = state) do
    own = Keyword.merge(opts.recognizer_options, changes)
    recognizer = Error.unwrap!(opts.recognizer.load(own))
    {[], %{state | recognizer: recognizer, opts: %{opts | recognizer_options: own}}}
  end

  defp sentence_text(%Utterance{text: text}), do: text
  defp sentence_text(text) when is_binary(text), do: text

  defp sentence_text(other),
    do: raise(Error.new(:bad_text, "not a string or utterance: #{inspect(other, limit: 5)}"))
end
