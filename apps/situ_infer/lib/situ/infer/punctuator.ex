defmodule Situ.Infer.Punctuator do
  @moduledoc false
  # Turns words into sentences (`Situ.Infer.punctuate/2`).

  @schema [
    punctuation: [
      type: {:or, [{:in, [:rules]}, :module]},
      default: :rules,
      doc: "Rules for English, or a module that punctuates, a `Situ.Infer.Speech.Punctuation`."
    ],
    options: [type: :keyword, default: [], doc: "Options for the module's `load/1`."]
  ]

  use Situ.Component,
    inputs: [in: Situ.Infer.Speech.Utterance],
    outputs: [out: Situ.Infer.Speech.Utterance],
    options: @schema

  alias Situ.Error
  alias Situ.Infer.Speech.Punctuation.Rules

  @impl true
  def init(opts) do
    module = if opts[:punctuation] == :rules, do: Rules, else: opts[:punctuation]
    with {:ok, punctuation} <- module.load(opts[:options]), do: {:ok, {module, punctuation}}
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
