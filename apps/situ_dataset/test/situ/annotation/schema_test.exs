defmodule Situ.Annotation.SchemaTest do
  use ExUnit.Case, async: true
  alias Situ.Annotation.Schema

  @moduletag :tmp_dir

  test "loads a schema as it was saved", %{tmp_dir: root} do
    {:ok, schema} =
      Schema.parse(%{
        "name" => "S",
        "description" => "who",
        "attributes" => [
          %{
            "name" => "Who",
            "kind" => "finite",
            "default" => "b",
            "values" => [
              %{"value" => "a", "fill" => "#ff0000", "text" => "#000000", "key" => "1"},
              "b"
            ]
          },
          %{"name" => "N", "kind" => "number", "default" => 2.5, "fill" => "#00ff00"},
          %{"name" => "Q", "kind" => "bool", "description" => "quiet?"}
        ]
      })

    path = Path.join(root, "s.json")
    :ok = Schema.save(schema, path)
    assert Schema.load(path) == {:ok, schema}
    assert Schema.default_values(schema) == %{"Who" => "b", "N" => 2.5, "Q" => false}
    assert Schema.parse_value(schema, "N", "3") == {:ok, 3}
    assert {:error, %{code: :bad_value}} = Schema.parse_value(schema, "N", "three")
    assert Schema.parse_value(schema, "Q", "true") == {:ok, true}
  end

  test "rejects an invalid schema with the position", %{tmp_dir: root} do
    finite = fn values ->
      %{"name" => "S", "attributes" => [%{"name" => "A", "kind" => "finite", "values" => values}]}
    end

    for {json, why} <- [
          {7, "attributes"},
          {%{"name" => "S", "attributes" => []}, "attributes"},
          {%{"name" => " ", "attributes" => [%{"name" => "A", "kind" => "text"}]}, "empty"},
          {%{"name" => "S", "attributes" => [7]}, "object"},
          {%{"name" => "S", "attributes" => [%{"name" => "A", "kind" => "rgb"}]}, "kind"},
          {finite.([]), "no values"},
          {finite.(["a", "a"]), "twice"},
          {finite.([%{"value" => "a", "key" => "1"}, %{"value" => "b", "key" => "1"}]), "twice"},
          {finite.([%{"value" => "a", "key" => "12"}]), "one printable"},
          {finite.([%{"value" => "a", "fill" => "red"}]), "rrggbb"}
        ] do
      assert {:error, %{code: :bad_schema, why: said}} = Schema.parse(json)
      assert said =~ why
    end

    File.write!(Path.join(root, "x.json"), "{")
    assert {:error, %{code: :bad_schema}} = Schema.load(Path.join(root, "x.json"))
    assert {:error, %{code: :not_found}} = Schema.load(Path.join(root, "none.json"))
  end
end
