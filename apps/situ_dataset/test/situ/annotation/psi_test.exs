defmodule Situ.Annotation.PsiTest do
  use ExUnit.Case, async: true
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Psi, Recording, Schema}
  alias Situ.Store

  # The terms have the form in which Situ.Bridge.Psi reads \psi's types.
  defp endpoint(time), do: %{"Bounded" => true, "Inclusive" => true, "Point" => time}

  defp one(track, from, to, values) do
    %{
      "Interval" => %{"LeftEndpoint" => endpoint(from), "RightEndpoint" => endpoint(to)},
      "Track" => track,
      "AttributeValues" =>
        Map.new(values, fn {name, value} ->
          {name, %{"$type" => "AnnotationValue`1", "Value" => value, "FillColor" => colour(0)}}
        end)
    }
  end

  defp set(all), do: %{"data" => Map.new(all, &{&1["Track"], &1})}

  defp colour(argb),
    do: %{"name" => nil, "value" => argb, "knownColor" => 0, "state" => 2}

  defp schema do
    %{
      "Name" => "Speech",
      "AttributeSchemas" => [
        %{
          "Name" => "Who",
          "Description" => "the speaker",
          "ValueSchema" => %{
            "DefaultValue" => "B",
            "PossibleValues" => [
              %{
                "Value" => "A",
                "FillColor" => colour(0xFF1F77B4),
                "TextColor" => colour(0xFFFFFFFF)
              },
              %{"Value" => "B", "FillColor" => %{"value" => 0, "state" => 1, "knownColor" => 44}}
            ]
          }
        },
        %{
          "Name" => "Words",
          "Description" => nil,
          "ValueSchema" => %{"DefaultValue" => "", "FillColor" => colour(0xFF00FF00)}
        }
      ]
    }
  end

  test "reads the annotations of all tracks of a set" do
    both =
      set([one("two", 5, 20, %{"Who" => "B"}), one("one", 0, 20, %{"Who" => "A", "Words" => nil})])

    assert {:ok, [first, second]} = Psi.decode_annotations(both)

    assert %Annotation{from: 0, to: 20, track: "one", values: %{"Who" => "A", "Words" => ""}} =
             first

    assert %Annotation{from: 5, track: "two"} = second
    assert Psi.decode_annotations(%{"data" => %{"x" => %{}}}) == :error
    assert Psi.decode_annotations(set([one("backwards", 9, 3, %{})])) == :error
    assert Psi.decode_annotations(%{"other" => 1}) == :error
  end

  @tag :tmp_dir
  test "reads a stream of sets with its schema", %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("annotated", root)
    {:ok, stream} = Store.Writer.stream(writer, "Speech", type: :map, metadata: schema())

    messages =
      for {n, to} <- [{1, 20}, {2, 30}] do
        data = set([one("one", to - 10, to, %{"Who" => "A", "Words" => "word #{n}"})])
        %Situ.Message{data: data, originating_time: to, creation_time: to, sequence_id: n}
      end

    {:ok, _} = Store.Writer.append(stream, messages)
    :ok = Store.Writer.close(writer)
    store = Store.open!(writer.path)
    {:ok, info} = Store.stream_info(store, "Speech")
    assert Recording.annotation_stream?(store, info)
    assert {:ok, layer} = Recording.load_layer(store, "Speech")

    assert [%{from: 10, to: 20, values: %{"Words" => "word 1"}}, %{to: 30}] =
             Layer.annotations(layer)

    assert %Schema{name: "Speech", attributes: [who, words]} = layer.schema

    assert {who.name, who.kind, who.default, who.description} ==
             {"Who", :finite, "B", "the speaker"}

    assert [%{value: "A", fill: "#1f77b4", text: "#ffffff"}, %{value: "B", fill: nil}] =
             who.values

    assert {words.kind, words.default, words.fill} == {:text, "", "#00ff00"}
  end

  test "says why a schema is invalid" do
    assert {:ok, json} =
             Psi.convert_schema(%{"Name" => "S", "AttributeSchemas" => [%{"Name" => nil}]})

    assert {:error, %{code: :bad_schema}} = Schema.parse(json)
    assert Psi.convert_schema(%{"name" => "ours"}) == :error
  end
end
