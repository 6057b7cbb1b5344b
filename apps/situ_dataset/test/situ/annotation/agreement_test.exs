defmodule Situ.Annotation.AgreementTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  import Situ.Annotation.Test.Annotating
  alias Situ.Annotation
  alias Situ.Annotation.{Agreement, Layer}

  doctest Situ.Annotation.Agreement

  # Counts frame by frame, as the definition says.
  defp by_frames(a, b, {from, to}, frame) do
    for track <- Enum.uniq(Layer.track_names(a) ++ Layer.track_names(b)),
        k <- 0..(div(to - from, frame) - 1)//1,
        at = 2 * (from + k * frame) + frame,
        reduce: %{} do
      counts -> Map.update(counts, {label(a, track, at), label(b, track, at)}, 1, &(&1 + 1))
    end
  end

  defp label(layer, track, twice) do
    found = Enum.find(Layer.on_track(layer, track), &(2 * &1.from <= twice and twice < 2 * &1.to))
    found && found.values["Speech"]
  end

  property "counts runs like a frame-by-frame comparison", numtests: 200 do
    forall {left, right, frame, to} <- {spans(), spans(), integer(1, 13), integer(1, 150)} do
      {a, b} = {layer(left), layer(right)}
      {:ok, report} = Agreement.compare_layers(a, b, frame: frame, from: 0, to: to)
      assert report.confusion == by_frames(a, b, {0, to}, frame)
    end
  end

  property "finds full agreement of a layer with itself" do
    forall spans <- spans() do
      layer = layer(spans)
      {:ok, report} = Agreement.compare_layers(layer, layer, frame: 1)
      assert report.kappa in [nil, 1.0]
      assert report.paired == length(Layer.annotations(layer))
      assert report.only_first + report.only_second == 0
      assert report.begin_error in [nil, 0.0] and report.end_error in [nil, 0.0]
    end
  end

  test "returns no kappa if chance explains everything or nothing is compared" do
    assert Agreement.kappa(%{{1, 1} => 5}) == {1.0, nil}
    assert Agreement.kappa(%{}) == {nil, nil}
    {:ok, report} = Agreement.compare_layers(layer([]), layer([]))
    assert {report.frames, report.kappa} == {0, nil}
  end

  test "rejects an unknown attribute and an interval with too many frames" do
    a = layer([{0, 10, "A", "speaks"}])
    assert {:error, %{code: :unknown_attribute}} = Agreement.compare_layers(a, a, attribute: "X")

    assert {:error, %{code: :too_many_frames}} =
             Agreement.compare_layers(a, a, frame: 1, to: 1_000_000_000)
  end

  test "pairs the annotations with the widest overlaps" do
    {:ok, a} = Layer.new(schema(), [Annotation.new(0, 10, "A"), Annotation.new(10, 40, "A")])
    {:ok, b} = Layer.new(schema(), [Annotation.new(2, 38, "A"), Annotation.new(50, 60, "A")])
    {:ok, report} = Agreement.compare_layers(a, b, frame: 1)
    assert {report.paired, report.only_first, report.only_second} == {1, 1, 1}
    assert {report.begin_error, report.end_error} == {8.0, 2.0}
  end
end
