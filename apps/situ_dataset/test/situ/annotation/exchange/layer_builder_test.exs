defmodule Situ.Annotation.Exchange.LayerBuilderTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.LayerBuilder
  alias Situ.Annotation.{Layer, Schema}

  @tiers [
    {"Utt", nil, nil},
    {"Words", "Utt", "included_in"},
    {"Cuts", "Utt", "time_subdivision"},
    {"Morphs", "Words", "symbolic_subdivision"},
    {"Gloss", "Words", "symbolic_association"}
  ]

  defp schema do
    tiers =
      for {name, parent, relation} <- @tiers,
          do: %{"name" => name, "attribute" => "Text", "parent" => parent, "relation" => relation}

    {:ok, schema} =
      Schema.parse(%{
        "name" => "Speech",
        "attributes" => [%{"name" => "Text", "kind" => "text"}],
        "tiers" => tiers
      })

    schema
  end

  property "keeps every annotation, also of files that break the rules of their tiers",
    numtests: 300 do
    tracks = for {name, _, _} <- @tiers, person <- ["", "@Ada"], do: name <> person
    spans = list({one_of(tracks), integer(0, 60), one_of([0, 1, 2, 3, 5, 12])})

    forall spans <- spans do
      annotations =
        for {{track, from, length}, i} <- Enum.with_index(spans),
            do: Annotation.new(from * 10, (from + length) * 10, track, %{"Text" => "#{i}"})

      {:ok, layer, _losses} = LayerBuilder.build_layer(schema(), annotations)
      texts = for a <- Layer.annotations(layer), do: a.values["Text"]
      assert Enum.sort(texts) == Enum.sort(for a <- annotations, do: a.values["Text"])
    end
  end
end
