defmodule Situ.Annotation.SpansTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Schema, Spans}

  defp run(items, opts \\ []) do
    replay = [replay: [interval: {0, :unbounded}, speed: :max]]

    Situ.to_list(
      fn p -> p |> Situ.from_enumerable(items) |> Spans.annotate(& &1, opts) end,
      times: true,
      pipeline: replay
    )
  end

  defp said(from, to, text, track \\ "Said"), do: {from, to, track, %{"Words" => text}}

  test "emits each annotation at its end, even if it arrived at its beginning" do
    out =
      run([{1, [said(1, 4, "go")]}, {4, [said(4, 9, "on")]}, {20, []}], by: "me", proposed: true)

    assert [{4, [go]}, {9, [on]}] = out

    assert {go.from, go.to, go.track, go.values, go.by, go.proposed?} ==
             {1, 4, "Said", %{"Words" => "go"}, "me", true}

    assert {on.from, on.to} == {4, 9}
  end

  test "emits pending annotations when the stream closes" do
    assert [{7, [%Annotation{from: 1, to: 7}]}] = run([{1, [said(1, 7, "long")]}])
  end

  test "starts an overlapping span at the end of the other, and drops late ones" do
    out = run([{5, [said(1, 5, "a")]}, {6, [said(3, 6, "b"), said(2, 4, "late", "Other")]}])
    assert [{5, [%{from: 1}]}, {6, [%{from: 5, to: 6}]}] = out
  end

  property "produces a valid layer from any spans" do
    schema = Schema.text("Words")

    forall spans <- list({integer(0, 40), integer(0, 9), integer(0, 9), integer(0, 1)}) do
      items =
        spans
        |> Enum.group_by(fn {at, _, _, _} -> at end, fn {at, before, length, n} ->
          said(max(at - before, 0), max(at - before, 0) + length, "x", Enum.at(["A", "B"], n))
        end)
        |> Enum.sort()

      out = run(items)
      times = Enum.map(out, &elem(&1, 0))
      all = Enum.flat_map(out, &elem(&1, 1))

      times == Enum.sort(Enum.uniq(times)) and
        Enum.all?(out, fn {time, list} -> Enum.all?(list, &(&1.to == time)) end) and
        match?({:ok, _}, Layer.new(schema, all))
    end
  end
end
