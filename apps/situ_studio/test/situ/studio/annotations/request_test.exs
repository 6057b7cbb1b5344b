defmodule Situ.Studio.Annotations.RequestTest do
  use ExUnit.Case, async: true
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Schema, TierText}
  alias Situ.Studio.Annotations.{Request, TierList}

  doctest TierList

  defp layer do
    {:ok, schema} = TierText.parse_schema("Talk", "Utterance\nWords in Utterance")

    {:ok, layer} =
      Layer.new(schema, [
        Annotation.new(0, 10, "Utterance", %{"Utterance" => "a"}),
        Annotation.new(20, 30, "Utterance", %{"Utterance" => "b"}),
        Annotation.new(22, 28, "Words", %{"Words" => "c"})
      ])

    layer
  end

  defp spans(layer), do: for(a <- Layer.annotations(layer), do: {a.track, a.from, a.to})

  test "annotations are moved with all later ones and with their children" do
    for {name, params, expected} <- [
          {"shift", %{"id" => 2, "by" => "5"},
           [{"Utterance", 0, 10}, {"Words", 27, 33}, {"Utterance", 25, 35}]},
          {"shift_after", %{"at" => "20", "by" => "-10"},
           [{"Utterance", 0, 10}, {"Words", 12, 18}, {"Utterance", 10, 20}]},
          {"ripple", %{"id" => 1, "edge" => "to", "to" => "12"},
           [{"Utterance", 0, 12}, {"Words", 24, 30}, {"Utterance", 22, 32}]},
          {"close_gap", %{"id" => 1}, [{"Words", 12, 18}, {"Utterance", 10, 20}]}
        ] do
      assert {:ok, layer, _} = Request.apply_change(name, layer(), params)
      assert spans(layer) == expected
    end
  end

  test "invalid requests are refused" do
    for {name, params} <- [
          {"shift", %{"id" => 2, "by" => "x"}},
          {"shift", %{"id" => "2", "by" => "1"}},
          {"shift_after", %{"at" => nil, "by" => "1"}},
          {"ripple", %{"id" => 1, "edge" => "middle", "to" => "1"}},
          {"close_gap", %{"id" => nil}}
        ] do
      assert {:error, %{code: :bad_request}} = Request.apply_change(name, layer(), params)
    end
  end

  test "an unknown parent of a tier is explained" do
    assert {:error, %{code: :bad_schema, why: why}} =
             TierText.parse_schema("T", "Words in Speech")

    assert why =~ "does not exist"
    assert %Schema{} = layer().schema
  end
end
