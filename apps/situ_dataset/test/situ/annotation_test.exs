defmodule Situ.AnnotationTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation

  doctest Situ.Annotation

  defp annotation({from, length, track}), do: Annotation.new(from, from + length, track)
  defp spans, do: list({integer(-50, 50), integer(0, 20), one_of(["A", "B"])})

  property "overlap is symmetric: a shared interval, a common end, or an inner point" do
    span = {integer(-20, 20), integer(0, 10), one_of(["A"])}

    forall {a, b} <- {span, span} do
      {a, b} = {annotation(a), annotation(b)}
      assert Annotation.overlap?(a, b) == Annotation.overlap?(b, a)
      shared = min(a.to, b.to) - max(a.from, b.from)
      within? = fn p, q -> p.from == p.to and q.from < p.from and p.from < q.to end

      assert Annotation.overlap?(a, b) ==
               (shared > 0 or a.to == b.to or within?.(a, b) or within?.(b, a))
    end
  end

  property "groups annotations into one message for each end, in order" do
    forall spans <- spans() do
      annotations = spans |> Enum.map(&annotation/1) |> Enum.uniq_by(&{&1.to, &1.track})
      messages = Annotation.to_messages(annotations)
      times = Enum.map(messages, & &1.originating_time)
      assert times == Enum.uniq(Enum.sort(times))
      assert Enum.flat_map(messages, & &1.data) |> Enum.sort() == Enum.sort(annotations)
      for m <- messages, a <- m.data, do: assert(a.to == m.originating_time)
    end
  end

  property "decodes annotations from JSON as they were encoded" do
    more = {one_of([nil, "ada"]), one_of([nil, 0.5]), one_of([nil, "note"]), boolean()}

    forall {span, {by, confidence, note, proposed?}} <-
             {{integer(), integer(0, 99), one_of(["A", "ü"])}, more} do
      a = %{
        annotation(span)
        | by: by,
          confidence: confidence,
          note: note,
          proposed?: proposed?,
          values: %{"x" => 1}
      }

      {:ok, json} = a |> Annotation.to_json() |> Situ.JSON.encode() |> Situ.JSON.decode()
      assert Annotation.from_json(json) == {:ok, a}
    end
  end

  test "rejects an invalid annotation with the reason" do
    whole = %{"from" => 0, "to" => 1, "track" => "A"}

    for {change, why} <- [
          {%{"from" => 2}, "before it begins"},
          {%{"from" => "0"}, "integer (ns)"},
          {%{"track" => ""}, "no name"},
          {%{"confidence" => 2}, "between 0.0 and 1.0"},
          {%{"values" => [1]}, "names"},
          {%{"note" => 5}, "not a string"},
          {%{"proposed" => "yes"}, "boolean"}
        ] do
      assert {:error, %{code: :bad_annotation} = error} =
               Annotation.from_json(Map.merge(whole, change))

      assert error.why =~ why
    end

    assert {:error, _} = Annotation.from_json([])
    assert_raise ArgumentError, ~r/before it begins/, fn -> Annotation.new(2, 1, "A") end
  end
end
