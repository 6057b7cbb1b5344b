defmodule Situ.Annotation.TierTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Edit, Layer, LayerOperation, Schema, Shift, TierRules}

  doctest Situ.Annotation.Shift

  @tiers [
    {"Utterance", nil, nil},
    {"Words", "Utterance", "included_in"},
    {"Parts", "Utterance", "time_subdivision"},
    {"Morphs", "Words", "symbolic_subdivision"},
    {"Gloss", "Morphs", "symbolic_association"},
    {"Translation", "Utterance", "symbolic_association"}
  ]

  defp schema(more \\ %{}) do
    tiers =
      for {name, parent, relation} <- @tiers,
          do: %{"name" => name, "attribute" => "Text", "parent" => parent, "relation" => relation}

    {:ok, schema} =
      Schema.parse(
        Map.merge(
          %{
            "name" => "Speech",
            "attributes" => [%{"name" => "Text", "kind" => "text"}],
            "tiers" => tiers
          },
          more
        )
      )

    schema
  end

  defp layer(spans) do
    {:ok, layer} = Layer.new(schema())

    Enum.reduce(spans, layer, fn {track, from, to}, layer ->
      {:ok, layer, _} = Layer.add(layer, Annotation.new(from, to, track, %{"Text" => "#{from}"}))
      layer
    end)
  end

  defp spans(layer, track),
    do: for(a <- Layer.on_track(layer, track), do: {a.from, a.to, a.values["Text"]})

  test "keeps tiers and the overlap rule in JSON" do
    schema = schema(%{"overlap" => "clip"})
    assert {:ok, ^schema} = schema |> Schema.to_json() |> Schema.parse()
  end

  test "rejects tiers that contradict each other, and says why" do
    for {tiers, word} <- [
          {[%{"name" => "A", "attribute" => "B"}], "unknown attribute"},
          {[%{"name" => "A", "attribute" => "Text", "parent" => "B"}], "needs both"},
          {[
             %{"name" => "A", "attribute" => "Text", "parent" => "B", "relation" => "included_in"}
           ], "does not exist"},
          {[
             %{"name" => "A", "attribute" => "Text", "parent" => "A", "relation" => "included_in"}
           ], "own ancestor"},
          {[%{"name" => "A", "attribute" => "Text"}, %{"name" => "A", "attribute" => "Text"}],
           "same name"},
          {[
             %{"name" => "A", "attribute" => "Text"},
             %{
               "name" => "B",
               "attribute" => "Text",
               "parent" => "A",
               "relation" => "symbolic_association"
             },
             %{"name" => "C", "attribute" => "Text", "parent" => "B", "relation" => "included_in"}
           ], "symbolic"},
          {"x", "not a list"},
          {[1], "must have"}
        ] do
      assert {:error, %{code: :bad_schema, why: why}} =
               Schema.parse(%{
                 "name" => "S",
                 "attributes" => [%{"name" => "Text", "kind" => "text"}],
                 "tiers" => tiers
               })

      assert why =~ word
    end
  end

  test "an annotation of a child tier needs a parent, and gets its times" do
    layer = layer([{"Utterance", 0, 100}])
    assert {:error, %{code: :no_parent}} = Layer.add(layer, Annotation.new(200, 210, "Words"))
    {:ok, layer, _} = Layer.add(layer, Annotation.new(90, 120, "Words"))
    {:ok, layer, _} = Layer.add(layer, Annotation.new(40, 50, "Translation"))
    assert spans(layer, "Words") == [{90, 100, ""}]
    assert spans(layer, "Translation") == [{0, 100, ""}]

    assert {:error, %{code: :overlap}} = Layer.add(layer, Annotation.new(1, 2, "Translation"))
    assert {:error, %{code: :bad_tier}} = Layer.add(layer, Annotation.new(300, 300, "Utterance"))
  end

  test "a time subdivision divides its parent without gaps" do
    layer =
      layer([{"Utterance", 0, 100}, {"Parts", 10, 20}, {"Parts", 30, 40}, {"Parts", 60, 70}])

    assert spans(layer, "Parts") == [{0, 30, "10"}, {30, 60, "30"}, {60, 100, "60"}]
    [_, second, _] = Layer.on_track(layer, "Parts")
    {:ok, moved, _} = Edit.move_edge(layer, second.id, :from, 20)
    assert spans(moved, "Parts") == [{0, 20, "10"}, {20, 60, "30"}, {60, 100, "60"}]
    {:ok, removed, _} = Layer.remove(layer, second.id)
    assert spans(removed, "Parts") == [{0, 60, "10"}, {60, 100, "60"}]
  end

  test "a symbolic subdivision divides its parent into equal parts" do
    layer = layer([{"Utterance", 0, 100}, {"Words", 0, 90}])
    layer = Enum.reduce([1, 2, 80], layer, &add_morph/2)
    assert spans(layer, "Morphs") == [{0, 30, "1"}, {30, 60, "2"}, {60, 90, "80"}]
  end

  defp add_morph(from, layer) do
    annotation = Annotation.new(from, from + 1, "Morphs", %{"Text" => "#{from}"})
    {:ok, layer, _} = Layer.add(layer, annotation)
    layer
  end

  test "children follow a parent that is moved, shortened, split, merged, or deleted" do
    layer =
      layer([
        {"Utterance", 0, 100},
        {"Utterance", 100, 150},
        {"Words", 10, 30},
        {"Words", 60, 80},
        {"Translation", 0, 100},
        {"Translation", 100, 150},
        {"Morphs", 10, 30},
        {"Gloss", 10, 30}
      ])

    {:ok, moved, _} = Edit.set_interval(layer, 1, {-5, 95})
    assert spans(moved, "Words") == [{5, 25, "10"}, {55, 75, "60"}]
    assert spans(moved, "Gloss") == [{5, 25, "10"}]
    {:ok, short, _} = Edit.set_interval(layer, 1, {20, 60})
    assert spans(short, "Words") == [{20, 30, "10"}]
    assert spans(short, "Gloss") == [{20, 30, "10"}]
    assert spans(short, "Translation") == [{20, 60, "0"}, {100, 150, "100"}]
    {:ok, split, _} = Edit.split_annotation(layer, 1, 70)
    assert spans(split, "Words") == [{10, 30, "10"}, {60, 70, "60"}]
    assert spans(split, "Translation") == [{0, 70, "0"}, {100, 150, "100"}]
    {:ok, merged, _} = Edit.merge_annotations(layer, 1, 2)
    assert spans(merged, "Translation") == [{0, 150, "0 100"}]
    {:ok, deleted, transaction} = Layer.remove(layer, 1)
    assert Layer.track_names(deleted) == ["Translation", "Utterance"]
    {:ok, undone} = Layer.apply_transaction(deleted, Layer.invert_transaction(transaction))
    assert Layer.annotations(undone) == Layer.annotations(layer)
  end

  test "an edit that leaves the times of a parent changes no children" do
    layer = layer([{"Utterance", 0, 100}, {"Words", 10, 30}, {"Translation", 0, 100}])
    {:ok, _, transaction} = Layer.set_value(layer, 1, "Text", "new")
    assert [{1, _, %{values: %{"Text" => "new"}}}] = transaction
  end

  test "the tracks of each person have their own parents" do
    layer = layer([{"Utterance@Ada", 0, 100}, {"Words@Ada", 20, 30}, {"Utterance@Ben", 200, 300}])
    assert {:error, %{code: :no_parent}} = Layer.add(layer, Annotation.new(0, 10, "Words@Ben"))
    {:ok, renamed, _} = Layer.change(layer, 1, track: "Utterance@Ben")
    assert spans(renamed, "Words@Ben") == [{20, 30, "20"}]

    assert {:error, %{code: :no_parent}} = Layer.change(layer, 1, track: "Other")
  end

  test "an operation of the log that contradicts the tiers is rejected" do
    layer = layer([{"Utterance", 0, 100}, {"Words", 20, 30}])
    utterance = Layer.fetch!(layer, 1)
    assert {:error, %{code: :no_parent}} = Layer.apply_transaction(layer, [{1, utterance, nil}])

    entry = %Situ.EditLog.Entry{
      kind: "edit",
      do: LayerOperation.encode_transaction([{1, utterance, nil}])
    }

    assert {:error, %{code: :no_parent}} = LayerOperation.apply_entry(layer, entry)

    assert {:error, %{code: :no_parent}} =
             Layer.new(schema(), [Annotation.new(0, 10, "Words", %{"Text" => ""})])
  end

  test "the time of an edit is linear in the children of the parent" do
    work = fn count ->
      parent = Annotation.new(0, count * 10, "Utterance", %{"Text" => ""})

      words =
        for i <- 0..(count - 1),
            do: Annotation.new(i * 10, i * 10 + 5, "Words", %{"Text" => ""})

      {:reductions, before} = Process.info(self(), :reductions)
      {:ok, layer} = Layer.new(schema(), [parent | words])
      {:ok, _, _} = Layer.change(layer, 2, to: 7)
      {:reductions, later} = Process.info(self(), :reductions)
      later - before
    end

    assert work.(800) < 6 * work.(200)
  end

  test "overlap rules of the schema" do
    for {rule, expected} <- [
          {"clip", [{0, 10, "a"}, {10, 20, "new"}, {20, 30, "b"}]},
          {"replace", [{0, 5, "a"}, {5, 25, "new"}, {25, 30, "b"}]}
        ] do
      {:ok, layer} =
        Layer.new(schema(%{"overlap" => rule}), [
          Annotation.new(0, 10, "Free", %{"Text" => "a"}),
          Annotation.new(20, 30, "Free", %{"Text" => "b"})
        ])

      {:ok, layer, _} = Edit.annotate(layer, Annotation.new(5, 25, "Free", %{"Text" => "new"}))
      assert spans(layer, "Free") == expected
    end
  end

  test "ripple edits move whole families" do
    layer = layer([{"Utterance", 0, 10}, {"Utterance", 20, 40}, {"Words", 25, 30}])
    {:ok, layer, _} = Shift.ripple_edge(layer, 1, :to, 15)
    assert spans(layer, "Words") == [{30, 35, "25"}]
    assert {:error, %{code: :no_parent}} = Shift.ripple_edge(layer, 3, :to, 34)
    assert {:error, %{code: :overlap}} = Shift.shift_after(layer, 25, -20)
    {:ok, layer, _} = Shift.close_gap(layer, 1)
    assert spans(layer, "Utterance") == [{10, 30, "20"}]
  end

  defp edits do
    track = one_of(Enum.map(@tiers, &elem(&1, 0)))
    id = integer(1, 20)
    time = integer(0, 120)

    list(
      one_of([
        {:add, time, integer(1, 60), track},
        {:add, time, integer(20, 60), "Utterance"},
        {:remove, id},
        {:edge, id, one_of([:from, :to]), time},
        {:split, id, time},
        {:merge, id, id},
        {:interval, id, time, integer(0, 40)},
        {:shift, id, integer(-20, 20)},
        {:after, time, integer(-10, 30)}
      ])
    )
  end

  defp run({:add, from, length, track}, layer),
    do: Layer.add(layer, Annotation.new(from, from + length, track))

  defp run({:remove, id}, layer), do: Layer.remove(layer, id)
  defp run({:edge, id, edge, time}, layer), do: Edit.move_edge(layer, id, edge, time)
  defp run({:split, id, time}, layer), do: Edit.split_annotation(layer, id, time)
  defp run({:merge, a, b}, layer), do: Edit.merge_annotations(layer, a, b)
  defp run({:shift, id, by}, layer), do: Shift.shift_annotations(layer, [id], by)
  defp run({:after, time, by}, layer), do: Shift.shift_after(layer, time, by)

  defp run({:interval, id, from, length}, layer),
    do: Edit.set_interval(layer, id, {from, from + length})

  # Checks the relations by brute force.
  defp sound?(layer) do
    Enum.all?(Layer.annotations(layer), fn a ->
      {_, parent, relation} = List.keyfind(@tiers, a.track, 0)
      parent == nil or related?(layer, a, parent, relation)
    end)
  end

  defp related?(layer, a, parent, relation) do
    [p] = for p <- Layer.on_track(layer, parent), p.from <= a.from and a.to <= p.to, do: p
    family = for c <- Layer.on_track(layer, a.track), p.from <= c.from and c.to <= p.to, do: c
    edges = [p.from | Enum.map(family, & &1.to)]

    case relation do
      "included_in" -> true
      "symbolic_association" -> {a.from, a.to} == {p.from, p.to}
      _ -> Enum.map(family, & &1.from) == Enum.drop(edges, -1) and List.last(edges) == p.to
    end
  end

  property "keeps the relations after any edit, and undoes all edits", numtests: 300 do
    forall edits <- edits() do
      first = layer([{"Utterance", 0, 60}, {"Words", 5, 40}, {"Parts", 0, 60}, {"Morphs", 5, 40}])

      {last, done} =
        Enum.reduce(edits, {first, []}, fn edit, {layer, done} ->
          case run(edit, layer) do
            {:ok, edited, transaction} ->
              assert sound?(edited)
              assert TierRules.check_layer(edited) == :ok
              {edited, [transaction | done]}

            {:error, %Situ.Error{}} ->
              {layer, done}
          end
        end)

      undone =
        Enum.reduce(done, last, fn transaction, layer ->
          {:ok, layer} = Layer.apply_transaction(layer, Layer.invert_transaction(transaction))
          layer
        end)

      Layer.annotations(undone) == Layer.annotations(first)
    end
  end
end
