defmodule Situ.Annotation.TierEditTest do
  use ExUnit.Case, async: true
  alias Situ.Annotation
  alias Situ.Annotation.{Editor, History, Layer, Recording, Schema, TierEdit, TierText}
  alias Situ.Store

  doctest TierEdit
  doctest TierText

  @moduletag :tmp_dir

  @lines "Utterance\nWords in Utterance\nKind of Words: noun, verb, other"

  defp schema do
    {:ok, schema} = TierText.parse_schema("Speech", @lines)
    schema
  end

  defp layer do
    annotations = [
      Annotation.new(0, 100, "Utterance", %{"Utterance" => "a dog barks"}),
      Annotation.new(10, 40, "Words", %{"Words" => "dog"}),
      Annotation.new(10, 40, "Kind", %{"Kind" => "noun"}),
      Annotation.new(0, 100, "Utterance@Ada", %{"Utterance" => "it runs"}),
      Annotation.new(50, 90, "Words@Ada", %{"Words" => "runs"}),
      Annotation.new(50, 90, "Kind@Ada", %{"Kind" => "verb"})
    ]

    {:ok, layer} = Layer.new(schema(), annotations)
    layer
  end

  defp values(layer), do: for(a <- Layer.annotations(layer), into: %{}, do: {a.track, a.values})
  defp tiers(layer), do: Enum.map(layer.schema.tiers, &TierText.format_tier/1)

  test "adds tiers of texts, of a vocabulary, and with an attribute that exists" do
    {:ok, layer} = TierEdit.add_tier(layer(), "Note of Words: sure, unsure")
    assert List.last(tiers(layer)) == "Note of Words"
    {:ok, layer, _} = Layer.add(layer, Annotation.new(10, 40, "Note"))
    assert values(layer)["Note"] == %{"Note" => "sure"}

    assert {:error, %{code: :tier_exists}} = TierEdit.add_tier(layer, "Words in Utterance")
    assert {:error, %{code: :bad_schema} = error} = TierEdit.add_tier(layer, "Glosses of Morphs")
    assert error.why =~ "Morphs"

    {:ok, plain} =
      Layer.new(Schema.text("Words"), [Annotation.new(0, 9, "Words", %{"Words" => "hello"})])

    {:ok, plain} = TierEdit.add_tier(plain, "Words")
    assert values(plain) == %{"Words" => %{"Words" => "hello"}}
    assert length(plain.schema.attributes) == 1
  end

  test "refuses a tier that the annotations of a track do not fit" do
    {:ok, layer} = Layer.new(schema(), [Annotation.new(0, 9, "Gestures")])
    assert {:error, %{code: :bad_tier_edit} = error} = TierEdit.add_tier(layer, "Gestures")
    assert error.why =~ "Gestures"
  end

  test "renames a tier with the tracks of all persons, its attribute and its children" do
    {:ok, layer} = TierEdit.rename_tier(layer(), "Words", "Tokens")
    assert tiers(layer) == ["Utterance", "Tokens in Utterance", "Kind of Tokens"]

    assert %{"Tokens" => %{"Tokens" => "dog"}, "Tokens@Ada" => %{"Tokens" => "runs"}} =
             values(layer)

    assert Layer.on_track(layer, "Words@Ada") == []

    assert {:error, %{code: :tier_exists}} = TierEdit.rename_tier(layer, "Tokens", "Kind")
    assert {:error, %{code: :no_tier} = error} = TierEdit.rename_tier(layer, "Words", "Tokens")
    assert error.fix =~ "Utterance, Tokens, Kind"
    assert {:error, %{code: :bad_schema}} = TierEdit.rename_tier(layer, "Tokens", " ")

    {:ok, free, _} = Layer.add(layer, Annotation.new(0, 5, "Gaze@Ben"))
    assert {:error, %{code: :track_exists}} = TierEdit.rename_tier(free, "Tokens", "Gaze")
  end

  test "keeps an attribute that two tiers share" do
    {:ok, schema} =
      Schema.parse(%{
        "name" => "S",
        "attributes" => [%{"name" => "A", "kind" => "text"}],
        "tiers" => [%{"name" => "A", "attribute" => "A"}, %{"name" => "B", "attribute" => "A"}]
      })

    {:ok, layer} = Layer.new(schema, [Annotation.new(0, 9, "B", %{"A" => "b"})])
    {:ok, renamed} = TierEdit.rename_tier(layer, "A", "C")
    assert for(t <- renamed.schema.tiers, do: {t.name, t.attribute}) == [{"C", "A"}, {"B", "A"}]
    {:ok, removed} = TierEdit.remove_tier(layer, "A")
    assert values(removed) == %{"B" => %{"A" => "b"}}
  end

  test "removes a tier in use only with its annotations" do
    assert {:error, %{code: :tier_in_use} = error} = TierEdit.remove_tier(layer(), "Words")
    assert error.why == ~s(tier "Words" has the tier "Kind" below it and 4 annotations)
    assert TierEdit.count_dependents(layer(), "Words") == %{tiers: 1, annotations: 4}

    {:ok, layer} = TierEdit.remove_tier(layer(), "Words", delete: true)
    assert tiers(layer) == ["Utterance"]
    assert Enum.map(layer.schema.attributes, & &1.name) == ["Utterance"]
    assert Layer.track_names(layer) == ["Utterance", "Utterance@Ada"]
    assert layer.next == layer().next

    {:ok, layer} = TierEdit.remove_tier(layer, "Utterance", delete: true)
    assert {tiers(layer), Layer.annotations(layer)} == {[], []}
    assert [%{name: "Utterance"}] = layer.schema.attributes
  end

  test "moves a tier and changes its relation" do
    {:ok, layer} = TierEdit.move_tier(layer(), "Kind", "Words")
    assert tiers(layer) == ["Utterance", "Kind of Words", "Words in Utterance"]
    {:ok, layer} = TierEdit.move_tier(layer, "Utterance", nil)
    assert tiers(layer) == ["Kind of Words", "Words in Utterance", "Utterance"]

    {:ok, layer} = TierEdit.change_parent(layer, "Kind in Words")
    assert hd(tiers(layer)) == "Kind in Words"

    assert {:error, %{code: :bad_tier_edit} = error} =
             TierEdit.change_parent(layer, "Words divides Utterance")

    assert error.why =~ "without gaps"
    assert {:error, %{code: :bad_schema}} = TierEdit.change_parent(layer, "Utterance in Kind")
  end

  test "changes a vocabulary, and annotations follow renamed values" do
    {:ok, layer} = TierEdit.change_values(layer(), "Kind", "noun -> N, verb, adjective")
    assert %{"Kind" => %{"Kind" => "N"}, "Kind@Ada" => %{"Kind" => "verb"}} = values(layer)

    assert {:error, %{code: :value_in_use} = error} =
             TierEdit.change_values(layer, "Kind", "noun, other")

    assert error.why =~ ~s("N" \(1\), "verb" \(1\))

    {:ok, layer} = TierEdit.change_values(layer, "Kind", "")
    assert Schema.find_attribute(layer.schema, "Kind").kind == :text
    {:ok, layer} = TierEdit.change_values(layer, "Kind", "verb, N")
    assert Schema.find_attribute(layer.schema, "Kind").default == "verb"
    assert {:error, %{code: :bad_schema}} = TierEdit.change_values(layer, "Kind", "N, verb, N")
  end

  test "values keep their keys and colors" do
    value = %{"value" => "noun", "key" => "n", "fill" => "#112233"}
    kind = %{"name" => "Kind", "kind" => "finite", "values" => [value]}
    tier = %{"name" => "Kind", "attribute" => "Kind"}
    {:ok, schema} = Schema.parse(%{"name" => "S", "attributes" => [kind], "tiers" => [tier]})
    {:ok, layer} = Layer.new(schema)
    {:ok, layer} = TierEdit.change_values(layer, "Kind", "noun -> N, verb")

    assert [%{value: "N", key: "n", fill: "#112233"}, %{value: "verb"}] =
             hd(layer.schema.attributes).values
  end

  describe "in an editor" do
    setup %{tmp_dir: root} do
      path = Path.join(root, "annotation")
      {:ok, editor} = Editor.start_link(path: path, stream: "Speech", schema: schema())

      {:ok, _} =
        Editor.edit(editor, fn empty ->
          transaction = for a <- Layer.annotations(layer()), do: {a.id, nil, a}
          {:ok, layer} = Layer.apply_transaction(empty, transaction)
          {:ok, layer, transaction}
        end)

      {:ok, path: path, editor: editor}
    end

    test "a change is one operation, which is saved, listed and undone after a restart",
         context do
      %{editor: editor, path: path} = context
      before = Editor.current_layer(editor)

      {:ok, _} =
        Editor.edit_schema(editor, &TierEdit.remove_tier(&1, "Words", delete: true), by: "Ada")

      {:ok, stored} = path |> Store.open!() |> Recording.load_layer("Speech")
      assert tiers(stored) == ["Utterance"]
      :ok = Editor.stop(editor)

      {:ok, [_, entry]} = History.list({path, "Speech"})
      assert entry.by == "Ada"
      assert entry.what =~ "remove tier Words; remove tier Kind; and 4 more changes"

      {:ok, layer} = History.undo({path, "Speech"})
      assert values(layer) == values(before)
      assert layer.schema == before.schema
      {:ok, layer} = History.redo({path, "Speech"})
      assert tiers(layer) == ["Utterance"]
    end

    test "two programs change different tiers, and neither change is lost", context do
      %{editor: editor, path: path} = context
      {:ok, other} = Editor.start_link(path: path, stream: "Speech")
      {:ok, _} = Editor.edit_schema(editor, &TierEdit.rename_tier(&1, "Words", "Tokens"))
      {:ok, layer} = Editor.edit_schema(other, &TierEdit.add_tier(&1, "Gloss of Tokens"))

      assert tiers(layer) == [
               "Utterance",
               "Tokens in Utterance",
               "Kind of Tokens",
               "Gloss of Tokens"
             ]

      {:ok, layer} = Editor.refresh(editor)
      assert length(layer.schema.tiers) == 4
    end

    test "an undo that would lose another person's change of the schema is refused", context do
      {:ok, _} = Editor.edit_schema(context.editor, &TierEdit.rename_tier(&1, "Words", "Tokens"))
      document = Situ.Annotation.LayerDocument.open(context.path, "Speech", nil)
      assert {:ok, %{document: path}} = document
      text = File.read!(path <> ".edits")
      assert text =~ "Tokens"

      # The entry of a user of another computer.
      Situ.EditLog.with_lock(path, fn ->
        {:ok, document} = Situ.Annotation.LayerDocument.open_locked(context.path, "Speech", nil)
        {:ok, later} = TierEdit.add_tier(document.layer, "Gloss of Tokens")
        operation = Situ.Annotation.LayerOperation.diff_layers(document.layer, later)
        entry = %{Situ.EditLog.Entry.new("edit", operation) | host: "elsewhere"}
        {:ok, _, _} = Situ.EditLog.append(document.log, entry)
      end)

      assert {:error, %{code: :stale_edit}} = Editor.undo(context.editor)
      assert length(Editor.current_layer(context.editor).schema.tiers) == 4
    end

    test "an edit of a tier that somebody else has renamed meanwhile is refused", context do
      %{editor: editor} = context
      seen = Editor.status(editor).version

      {:ok, _} =
        Editor.edit_schema(editor, &TierEdit.rename_tier(&1, "Words", "Tokens"), by: "Ada")

      add = fn track -> &Layer.add(&1, Annotation.new(100, 101, track)) end

      assert {:error, %{code: :stale_edit} = error} =
               Editor.edit(editor, add.("Words"), by: "Ben", version: seen)

      assert error.what == "the tiers were changed by someone else"
      assert {:ok, _} = Editor.edit(editor, add.("Gestures"), by: "Ben", version: seen)
    end

    test "a failing edit changes nothing", %{editor: editor} do
      before = Editor.current_layer(editor)

      assert {:error, %{code: :tier_in_use}} =
               Editor.edit_schema(editor, &TierEdit.remove_tier(&1, "Words"))

      assert {:error, %{code: :edit_failed}} = Editor.edit_schema(editor, fn _ -> raise "no" end)
      assert Editor.current_layer(editor) == before
    end
  end
end
