defmodule Situ.Chat.PunctuationTest do
  use ExUnit.Case, async: true
  alias Situ.Chat.Punctuation
  alias Situ.Infer.Speech.Utterance
  alias Situ.Infer.Test.ChatServer

  defp said(text), do: %Utterance{text: text, from: 0, to: 1, confidence: 0.9}

  defp run(texts, opts) do
    Situ.to_list(fn p ->
      p
      |> Situ.from_enumerable(Enum.map(texts, &said/1), every: 1)
      |> Situ.map(& &1, type: Utterance)
      |> Situ.Infer.punctuate(opts)
    end)
  end

  test "uses a language model's result only if it keeps the words" do
    answers = %{
      "yes we can he said" => "Yes, we can, he said.",
      "tell me more" => "Here is more: ..."
    }

    server =
      ChatServer.start(fn %{body: body}, _ ->
        ChatServer.stream([answers[List.last(body["messages"])["content"]]])
      end)

    opts = [punctuation: Punctuation, options: [url: server.url, model: "small"]]

    assert ["Yes, we can, he said.", "Tell me more."] =
             run(Map.keys(answers) |> Enum.sort(:desc), opts) |> Enum.map(& &1.text)
  end

  test "a missing model is an error of the component" do
    opts = [
      punctuation: Punctuation,
      options: [url: "http://127.0.0.1:1/v1", model: "small", retries: 0]
    ]

    assert_raise Situ.Error, ~r/cannot reach/, fn -> run(["go on"], opts) end
  end
end
