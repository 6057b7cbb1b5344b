defmodule Situ.Annotation.LayerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  import Situ.Annotation.Test.Annotating
  alias Situ.Annotation
  alias Situ.Annotation.{Edit, Layer, Schema}

  doctest Situ.Annotation.Attribute
  doctest Situ.Annotation.Schema
  doctest Situ.Annotation.Layer
  doctest Situ.Annotation.Edit

  defp spans_of(layer), do: for(a <- Layer.annotations(layer), do: {a.track, a.from, a.to})

  # Checks every rule by brute force.
  defp sound?(layer) do
    all = Layer.annotations(layer)

    pairs =
      for a <- all,
          b <- all,
          a.id < b.id,
          a.track == b.track,
          Annotation.overlap?(a, b),
          do: {a, b}

    by_track = for t <- Layer.track_names(layer), a <- Layer.on_track(layer, t), do: a

    pairs == [] and Enum.all?(all, &(&1.from <= &1.to)) and
      Enum.all?(all, &(Schema.check_values(layer.schema, &1.values) == :ok)) and
      Enum.sort(by_track) == Enum.sort(all) and
      Enum.all?(Layer.track_names(layer), fn t ->
        own = Layer.on_track(layer, t)
        own == Enum.sort_by(own, &{&1.from, &1.to})
      end)
  end

  property "keeps the rules after any edit, and rejected edits change nothing", numtests: 300 do
    forall {spans, edits} <- {spans(), edits()} do
      Enum.reduce(edits, layer(spans), fn edit, layer ->
        case run(edit, layer) do
          {:ok, edited, _} ->
            assert sound?(edited)
            edited

          {:error, %Situ.Error{}} ->
            layer
        end
      end)

      true
    end
  end

  property "undoes all edits to the original, and redoes them", numtests: 200 do
    forall {spans, edits} <- {spans(), edits()} do
      first = layer(spans)

      {last, done} =
        Enum.reduce(edits, {first, []}, fn edit, {layer, done} ->
          case run(edit, layer) do
            {:ok, layer, transaction} -> {layer, [transaction | done]}
            {:error, _} -> {layer, done}
          end
        end)

      undone =
        Enum.reduce(done, last, fn transaction, layer ->
          {:ok, layer} = Layer.apply_transaction(layer, Layer.invert_transaction(transaction))
          layer
        end)

      redone =
        Enum.reduce(Enum.reverse(done), undone, fn transaction, layer ->
          {:ok, layer} = Layer.apply_transaction(layer, transaction)
          layer
        end)

      Layer.annotations(undone) == Layer.annotations(first) and
        Layer.annotations(redone) == Layer.annotations(last)
    end
  end

  property "finds annotations like a linear search" do
    forall {spans, time} <- {spans(), integer(-5, 140)} do
      layer = layer(spans)
      all = Layer.on_track(layer, "A")

      assert Layer.previous_annotation(layer, "A", time) ==
               all |> Enum.filter(&(&1.from < time)) |> List.last()

      assert Layer.next_annotation(layer, "A", time) == Enum.find(all, &(&1.from > time))

      assert Layer.annotation_at(layer, "A", time) ==
               all |> Enum.filter(&Annotation.contains?(&1, time)) |> List.last()
    end
  end

  test "touching is not an overlap, but inner points and equal ends are" do
    {:ok, layer} = Layer.new(schema(), [Annotation.new(10, 20, "A")])

    for {from, to} <- [{0, 10}, {20, 30}, {10, 10}],
        do: assert({:ok, _, _} = Layer.add(layer, Annotation.new(from, to, "A")))

    for {from, to} <- [{5, 11}, {15, 15}, {20, 20}, {0, 20}, {10, 20}, {0, 40}, {12, 13}],
        do: assert({:error, %{code: :overlap}} = Layer.add(layer, Annotation.new(from, to, "A")))

    assert {:ok, _, _} = Layer.add(layer, Annotation.new(5, 11, "B"))
  end

  test "moving an edge moves a touching neighbor and keeps a part of it" do
    layer = layer([{0, 10, "A", "speaks"}, {10, 10, "A", "laughs"}, {30, 5, "A", "silent"}])
    {:ok, both, _} = Edit.move_edge(layer, 1, :to, 15)
    assert spans_of(both) == [{"A", 0, 15}, {"A", 15, 20}, {"A", 30, 35}]
    {:ok, both, _} = Edit.move_edge(layer, 1, :to, 25)
    assert spans_of(both) == [{"A", 0, 19}, {"A", 19, 20}, {"A", 30, 35}]
    {:ok, both, _} = Edit.move_edge(layer, 2, :from, -5)
    assert spans_of(both) == [{"A", 0, 1}, {"A", 1, 20}, {"A", 30, 35}]
    {:ok, alone, _} = Edit.move_edge(layer, 2, :from, 15, alone: true)
    assert spans_of(alone) == [{"A", 0, 10}, {"A", 15, 20}, {"A", 30, 35}]
  end

  test "an edge stops at a separate neighbor and at its own other end" do
    layer = layer([{0, 10, "A", "speaks"}, {20, 10, "A", "laughs"}])
    {:ok, wide, _} = Edit.move_edge(layer, 1, :to, 25)
    assert spans_of(wide) == [{"A", 0, 20}, {"A", 20, 30}]
    {:ok, wide, _} = Edit.move_edge(wide, 2, :from, 15, alone: true)
    assert spans_of(wide) == [{"A", 0, 20}, {"A", 20, 30}]
    {:ok, back, _} = Edit.move_edge(layer, 2, :from, 99)
    assert spans_of(back) == [{"A", 0, 10}, {"A", 30, 30}]
  end

  test "proposals fill gaps, and are accepted or rejected by confidence" do
    layer = layer([{0, 10, "A", "speaks"}])
    proposal = &Annotation.new(&1, &2, "A", %{"Speech" => "laughs"}, confidence: &3)

    {:ok, layer, undo} =
      Edit.add_proposals(layer, [
        proposal.(5, 8, 0.9),
        proposal.(10, 20, 0.9),
        proposal.(30, 40, 0.2)
      ])

    assert length(undo) == 2
    {:ok, layer, _} = Edit.accept_all(layer, 0.5, "me")

    assert for(a <- Layer.annotations(layer), do: {a.from, a.proposed?, a.by}) == [
             {0, false, nil},
             {10, false, "me"},
             {30, true, nil}
           ]

    {:ok, layer, _} = Edit.reject_all(layer, 0.5)
    assert length(Layer.annotations(layer)) == 2
  end

  test "copies boundaries to an empty track with default values" do
    layer = layer([{0, 10, "A", "laughs"}, {20, 5, "A", "laughs"}])
    {:ok, copied, _} = Edit.copy_boundaries(layer, Layer.on_track(layer, "A"), "B")

    assert for(a <- Layer.on_track(copied, "B"), do: {a.from, a.to, a.values["Speech"]}) == [
             {0, 10, "speaks"},
             {20, 25, "speaks"}
           ]

    assert {:error, %{code: :not_empty}} = Edit.copy_boundaries(copied, [], "A")
  end

  test "reports the second of two concurrent edits of an annotation" do
    layer = layer([{0, 10, "A", "speaks"}])
    {:ok, mine, edit} = Layer.set_value(layer, 1, "Words", "x")
    {:ok, _, other} = Layer.set_value(layer, 1, "Words", "y")
    assert {:error, %{code: :stale_edit}} = Layer.apply_transaction(mine, other)
    assert {:error, %{code: :stale_edit}} = Layer.apply_transaction(mine, edit)
  end
end
