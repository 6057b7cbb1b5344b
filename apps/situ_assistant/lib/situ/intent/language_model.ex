defmodule Situ.Intent.LanguageModel do
  @moduledoc """
  Detects intents with a language model: each intent is described as a tool, and the model calls the matching tool.

      timer = %Situ.Chat.Tool{
        name: "timer",
        about: "Rings later.",
        arguments: %{type: "object", properties: %{minutes: %{type: "number"}}}
      }

      {:ok, model} = Situ.Intent.LanguageModel.load(intents: [timer], model: "llama3.2")
      {:ok, intent} = Situ.Intent.LanguageModel.detect(model, "wake me in five minutes")

  Only the given names can become intents. Errors are those of `Situ.Chat`.
  """

  @own [
    intents: [
      type: {:list, {:struct, Situ.Chat.Tool}},
      required: true,
      doc:
        "The possible intents: each is a `Situ.Chat.Tool` without a function, whose arguments are the entities."
    ]
  ]
  @schema @own ++ Situ.Chat.Model.schema()

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Intent.Recognizer
  alias Situ.{Chat, Error, Intent}

  @system "Call the one function that does what the user wants. Call none if no function fits."

  @impl true
  @spec load(keyword()) :: {:ok, keyword()} | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {intents, model_opts} = Keyword.pop!(opts, :intents),
         {:ok, _} <- Chat.Model.new(model_opts) do
      tools = for intent <- intents, do: %{intent | run: nil}
      {:ok, model_opts ++ [tools: tools, system: @system]}
    end
  end

  @impl true
  @spec detect(keyword(), String.t()) :: {:ok, Intent.t()} | {:error, Error.t()}
  def detect(opts, text) do
    names = Enum.map(opts[:tools], & &1.name)

    with {:ok, answer} <- Chat.ask(text, opts) do
      calls = Enum.filter(answer.calls, &(&1.name in names))
      intents = for call <- calls, do: %{value: call.name, score: 1.0}

      entities =
        for call <- Enum.take(calls, 1),
            {type, value} <- Enum.sort(call.arguments),
            do: %{type: type, value: entity_value(value), score: 1.0}

      {:ok, %Intent{query: text, intents: intents, entities: entities}}
    end
  end

  defp entity_value(value) when is_binary(value), do: value
  defp entity_value(value), do: Situ.JSON.encode(value)
end
