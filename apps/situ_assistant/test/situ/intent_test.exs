defmodule Situ.IntentTest do
  use ExUnit.Case, async: true
  doctest Situ.Intent

  alias Situ.Chat.Tool
  alias Situ.Infer.Speech.Utterance
  alias Situ.Infer.Test.ChatServer, as: Server
  alias Situ.Intent
  alias Situ.Intent.Detector

  defp grammar(word), do: "#JSGF V1.0; grammar g; public <a> = #{word} {intent=#{word}};"

  test "a grammar can be changed while the component is running" do
    test =
      Situ.Test.start([:in, :options], fn streams ->
        Situ.via(Map.to_list(streams), Detector, recognizer_options: [grammar: grammar("stop")])
      end)

    Situ.Test.advance(test, 100)
    Situ.Test.feed(test, :in, [{0, "stop"}, {10, "go"}])
    assert [{0, %{intents: [%{value: "stop"}]}}, {10, %{intents: []}}] = Situ.Test.outputs(test)
    Situ.Test.feed(test, :options, [{15, [grammar: grammar("go")]}])
    Situ.Test.feed(test, :in, [{20, said("Go!")}, {30, "stop"}])
    assert [{20, %{intents: [%{value: "go"}]}}, {30, %{intents: []}}] = Situ.Test.outputs(test)
    assert {:ok, _} = Situ.Test.stop(test)
  end

  defp said(text), do: %Utterance{text: text, from: 0, to: 1, confidence: 1.0}

  @tag :capture_log
  test "an invalid grammar stops the pipeline before its first message" do
    build = fn p ->
      texts = Situ.from_enumerable(p, ["hello"], every: 1)
      Situ.via([in: texts], Detector, recognizer_options: [grammar: "#JSGF"])
    end

    assert {:error, %{code: :bad_grammar}} = Situ.Pipeline.run(build)
  end

  test "a language model finds intents" do
    call = fn name, arguments ->
      function = %{name: name, arguments: arguments}
      delta = %{tool_calls: [%{index: 0, id: "1", function: function}]}

      [
        Server.head(),
        Server.chunk(Server.event(%{choices: [%{delta: delta, finish_reason: "tool_calls"}]})),
        Server.chunk("data: [DONE]\n\n"),
        Server.chunk("")
      ]
    end

    server =
      Server.start(fn %{body: %{"messages" => turns}}, _ ->
        case List.last(turns)["content"] do
          "tea in five" -> call.("timer", ~s({"minutes": 5, "name": "tea"}))
          "fly" -> call.("rocket", "{}")
          _ -> Server.stream(["Hello."])
        end
      end)

    timer = %Tool{name: "timer", about: "Rings later."}
    {:ok, model} = Intent.LanguageModel.load(intents: [timer], url: server.url, model: "small")
    assert {:ok, intent} = Intent.LanguageModel.detect(model, "tea in five")

    assert {Intent.name(intent), Intent.entity(intent, "minutes"), Intent.entity(intent, "name")} ==
             {"timer", "5", "tea"}

    for text <- ["fly", "hello"],
        do: assert({:ok, %{intents: [], entities: []}} = Intent.LanguageModel.detect(model, text))
  end
end
