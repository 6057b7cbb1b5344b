defmodule Situ.Infer.Punctuator do
  @moduledoc false
  # Turns words into sentences (`Situ.Infer.punctuate/2`). Input and output are
  # `Situ.Infer.Speech.Utterance`s at the same times.

  @schema [
    punctuation: [
      type: :module,
      default: Situ.Infer.Speech.Punctuation.Rules,
      doc: "The module that punctuates, a `Situ.Infer.Speech.Punctuation`."
    ],
    options: [type: :keyword, default: [], doc: "Options for its `load/1`."]
  ]

  use Situ.Component,
    inputs: [in: Situ.Infer.Speech.Utterance],
    outputs: [out: Situ.Infer.Speech.Utterance],
    options: @schema

  alias Situ.Error

  @impl true
  def init(opts) do
    with {:ok, punctuation} <- opts[:punctuation].load(opts[:options]),
         do: {:ok, {opts[:punctuation], punctuation}}
  end

  @impl true
  def handle_message(
        :in,
        %{data: utterance, originating_time: time},
        _context,
        {module, punctuation}
      ) do
    text = Error.unwrap!(module.punctuate(punctuation, utterance.text))
    {[{:out, time, %{utterance | text: text}}], {module, punctuation}}
  end
end
