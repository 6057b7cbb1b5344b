defmodule Situ.Chat.AnswerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Chat.Answer
  doctest Situ.Chat.Turn
  doctest Situ.Chat.ToolCall

  alias Situ.Chat.Answer

  defp fold(events) do
    Enum.reduce(events, Answer.empty_partial(), fn event, piece ->
      {:ok, _, piece} = Answer.add_event(piece, Situ.JSON.encode(event))
      piece
    end)
  end

  defp call(index, part),
    do: %{choices: [%{delta: %{tool_calls: [Map.put(part, :index, index)]}}]}

  test "tool calls arrive in parts, several in parallel" do
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
      |> Answer.to_answer()

    assert [%{id: "a", name: "timer", arguments: %{"minutes" => 5}}, %{id: "b", name: "time"}] =
             answer.calls

    assert {answer.finish, answer.tokens, answer.exact?} == {:calls, %{read: 7, written: 9}, true}
  end

  test "understands services that number calls badly or repeat their names" do
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
        |> Answer.to_answer()

      assert [
               %{id: "a", name: "timer", arguments: %{"minutes" => 5}},
               %{id: "b", name: "time", arguments: %{}}
             ] = answer.calls
    end
  end

  test "half a character becomes a replacement character and does not end the response" do
    event = fn text -> ~s({"choices": [{"delta": {"content": "#{text}"}}]}) end
    assert {:ok, ["a\uFFFD"], _} = Answer.add_event(Answer.empty_partial(), event.("a\\ud83d"))
    assert {:ok, ["\uFFFDb"], _} = Answer.add_event(Answer.empty_partial(), event.("\\ude00b"))

    assert {:ok, ["😀\uFFFD"], _} =
             Answer.add_event(Answer.empty_partial(), event.("\\ud83d\\ude00\\ud83d"))
  end

  test "accepts a response that was not streamed" do
    piece = fold([%{choices: [%{message: %{content: "Yes."}, finish_reason: "length"}]}])
    assert %{text: "Yes.", finish: :length, exact?: false} = Answer.to_answer(piece)
  end

  test "ignores empty errors" do
    event = ~s({"error": null, "choices": [{"delta": {"content": "Yes."}}]})
    assert {:ok, ["Yes."], _} = Answer.add_event(Answer.empty_partial(), event)
  end

  test "reports errors in the stream, text that is not JSON, and endless responses" do
    assert {:error, %{code: :service_failed}} =
             Answer.add_event(Answer.empty_partial(), ~s({"error": {"message": "full"}}))

    assert {:error, %{code: :bad_response}} = Answer.add_event(Answer.empty_partial(), "<html>")
    many = fold(for i <- 1..64, do: call(i, %{id: "#{i}"}))

    assert {:error, %{code: :too_long}} =
             Answer.add_event(many, Situ.JSON.encode(call(65, %{id: "x"})))
  end

  property "unexpected values in any field never raise" do
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

      match?({:ok, _, _}, Answer.add_event(Answer.empty_partial(), Situ.JSON.encode(event)))
    end
  end

  defp choices(true, choice), do: [choice]
  defp choices(1, choice), do: [choice]
  defp choices(other, _), do: other
end
