defmodule Situ.Infer.Punctuator do
  @schema [
    punctuation: [
      type: :module,
      default: Situ.Infer.Speech.Punctuation.Rules,
      doc: "The module that punctuates, a `Situ.Infer.Speech.Punctuation`."
    ],
    options: [type: :keyword, default: [], doc: "Options for its `load/1`."]
  ]

  @moduledoc """
  Turns words into sentences (`Situ.Infer.punctuate/2`). Input and output are `Situ.Infer.Speech.Utterance`s at the same
  times.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [in: Situ.Infer.Speech.Utterance],
    outputs: [out: Situ.Infer.Speech.Utterance],
    options: @schema

  alias Situ.Error

  @impl true
  def init(opts) do
    with {:ok, loaded} <- opts[:punctuation].load(opts[:options]),
         do: {:ok, {opts[:punctuation], loaded}}
  end

  @impl true
  def handle_message(:in, %{data: said, originating_time: time}, _context, {module, loaded}) do
    text = Error.unwrap!(module.punctuate(loaded, said.text))
    {[{:out, time, %{said | text: text}}], {module, loaded}}
  end
end
