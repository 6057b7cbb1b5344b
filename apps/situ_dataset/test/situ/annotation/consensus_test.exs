defmodule Situ.Annotation.ConsensusTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Agreement, Consensus, Layer, Schema}

  doctest Situ.Annotation.Consensus

  defp layer(spans) do
    {:ok, empty} = Layer.new(Schema.finite("S", ["a", "b"]))

    Enum.reduce(spans, empty, fn {from, length, track, label}, layer ->
      case Layer.add(layer, Annotation.new(from, from + length, track, %{"S" => label})) do
        {:ok, layer, _} -> layer
        {:error, _} -> layer
      end
    end)
  end

  defp spans, do: list({integer(0, 60), integer(1, 20), one_of(["P", "Q"]), one_of(["a", "b"])})

  property "segments have every annotator's label at every time, and the shares of Agreement",
    numtests: 150 do
    forall {one, two, three} <- {spans(), spans(), spans()} do
      layers = [{"1", layer(one)}, {"2", layer(two)}, {"3", layer(three)}]
      {:ok, segments} = Consensus.find_segments(layers)

      for track <- ["P", "Q"], t <- 0..90 do
        middle = t + 0.5
        found = Enum.find(segments, &(&1.track == track and &1.from < middle and middle < &1.to))

        expected =
          Map.new(layers, fn {who, l} ->
            a = Enum.find(Layer.on_track(l, track), &(&1.from < middle and middle < &1.to))
            {who, a && a.values["S"]}
          end)

        if found,
          do: assert(found.labels == expected),
          else: assert(Enum.all?(expected, fn {_, label} -> label == nil end))
      end

      {:ok, consensus} = Consensus.build_layer(Schema.finite("S", ["a", "b"]), segments)
      agreed = for a <- Layer.annotations(consensus), not a.proposed?, do: a.to - a.from
      same = for s <- segments, s.agree?, do: s.to - s.from
      Enum.sum(agreed) == Enum.sum(same)
    end
  end

  test "kappa is computed from the disagreement of two layers" do
    {a, b} =
      {layer([{0, 40, "P", "a"}, {50, 10, "P", "b"}]),
       layer([{5, 40, "P", "a"}, {50, 10, "P", "a"}])}

    {:ok, segments} = Consensus.find_segments([{"1", a}, {"2", b}])
    {:ok, agreement} = Agreement.compare_layers(a, b, frame: 1, tracks: ["P"])
    differ = for s <- segments, not s.agree?, do: s.to - s.from
    assert Enum.sum(differ) == round((1 - agreement.agreement) * agreement.frames)
  end

  test "short disagreements at boundaries are ignored" do
    {a, b} =
      {layer([{0, 40, "P", "a"}, {40, 20, "P", "b"}]),
       layer([{0, 44, "P", "a"}, {44, 18, "P", "b"}])}

    {:ok, segments} = Consensus.find_segments([{"1", a}, {"2", b}], tolerance: 5)
    assert for(s <- segments, do: {s.from, s.to, s.agree?}) == [{0, 42, true}, {42, 61, true}]
  end

  test "layers must have the attribute" do
    assert {:error, %{code: :unknown_attribute}} =
             Consensus.find_segments([{"1", layer([])}], attribute: "T")

    assert {:error, %{code: :no_layers}} = Consensus.find_segments([])
  end
end
