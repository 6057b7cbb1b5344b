defmodule Situ.Chat.AnswerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Chat.Answer
  doctest Situ.Chat.Turn
  doctest Situ.Chat.ToolCall

  alias Situ.Chat.Answer

  defp fold(events) do
    Enum.reduce(events, Answer.piece(), fn event, piece ->
      {:ok, _, piece} = Answer.fold(piece, Situ.JSON.encode(event))
      piece
    end)
  end

  defp call(index, part),
    do: %{choices: [%{delta: %{tool_calls: [Map.put(part, :index, index)]}}]}

  test "calls of tools come in parts, several at once" do
    answer =
      [
        call(0, %{id: "a", function: %{name: "timer", arguments: ""}}),
        call(1, %{id: "b", function: %{name: "time", arguments: "{}"}}),
        call(0, %{function: %{arguments: ~s({"minutes")}}),
        call(0, %{function: %{arguments: ": 5}"}}),
        %{choices: [%{delta: %{}, finish_reason: "tool_calls"}]},
        %{choices: [], usage: %{prompt_tokens: 7, completion_tokens: 9}}
      ]
      |> fold()
      |> Answer.whole()

    assert [%{id: "a", name: "timer", arguments: %{"minutes" => 5}}, %{id: "b", name: "time"}] =
             answer.calls

    assert {answer.finish, answer.tokens, answer.exact?} == {:calls, %{read: 7, written: 9}, true}
  end

  test "services that number calls badly, or repeat their names, are understood" do
    part = fn id, name, arguments -> %{id: id, function: %{name: name, arguments: arguments}} end

    for number <- [&call(0, &1), &%{choices: [%{delta: %{tool_calls: [&1]}}]}] do
      answer =
        [
          number.(part.("a", "timer", ~s({"minutes"))),
          number.(part.("a", "timer", ": 5}")),
          number.(part.("b", "time", "{")),
          number.(%{function: %{arguments: "}"}})
        ]
        |> fold()
        |> Answer.whole()

      assert [
               %{id: "a", name: "timer", arguments: %{"minutes" => 5}},
               %{id: "b", name: "time", arguments: %{}}
             ] = answer.calls
    end
  end

  test "a character that was cut in half is a mark, not the end of the answer" do
    event = fn text -> ~s({"choices": [{"delta": {"content": "#{text}"}}]}) end
    assert {:ok, ["a\uFFFD"], _} = Answer.fold(Answer.piece(), event.("a\\ud83d"))
    assert {:ok, ["\uFFFDb"], _} = Answer.fold(Answer.piece(), event.("\\ude00b"))
    assert {:ok, ["😀\uFFFD"], _} = Answer.fold(Answer.piece(), event.("\\ud83d\\ude00\\ud83d"))
  end

  test "an answer that was not streamed is one, too" do
    piece = fold([%{choices: [%{message: %{content: "Yes."}, finish_reason: "length"}]}])
    assert %{text: "Yes.", finish: :length, exact?: false} = Answer.whole(piece)
  end

  test "an error that is none is none, and services complain in several ways" do
    event = ~s({"error": null, "choices": [{"delta": {"content": "Yes."}}]})
    assert {:ok, ["Yes."], _} = Answer.fold(Answer.piece(), event)

    for said <- [
          %{"message" => "full"},
          %{"detail" => [%{"msg" => "full"}]},
          %{"error" => %{"message" => "full"}}
        ],
        do: assert(Answer.complaint(said) == "full")
  end

  test "errors in the stream, text that is no JSON, answers without end" do
    assert {:error, %{code: :service_failed}} =
             Answer.fold(Answer.piece(), ~s({"error": {"message": "full"}}))

    assert {:error, %{code: :bad_response}} = Answer.fold(Answer.piece(), "<html>")
    many = fold(for i <- 1..64, do: call(i, %{id: "#{i}"}))

    assert {:error, %{code: :too_long}} =
             Answer.fold(many, Situ.JSON.encode(call(65, %{id: "x"})))
  end

  property "whatever a service sends where something else belongs, nothing breaks" do
    value =
      one_of(
        Enum.map(
          [nil, 1, -5, "x", [], [1], %{}, %{"a" => 3}, [%{"index" => "a"}], true],
          &constant/1
        )
      )

    forall {a, b, c, d, e} <- {value, value, value, value, value} do
      event = %{
        "choices" =>
          choices(a, %{"delta" => %{"content" => b, "tool_calls" => c}, "finish_reason" => d}),
        "usage" => e
      }

      match?({:ok, _, _}, Answer.fold(Answer.piece(), Situ.JSON.encode(event)))
    end
  end

  defp choices(true, choice), do: [choice]
  defp choices(1, choice), do: [choice]
  defp choices(other, _), do: other
end
