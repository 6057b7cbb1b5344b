defmodule Situ.Annotation.Exchange.BoxTracksTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Exchange, Layer}
  alias Situ.Annotation.Exchange.BoxTracks

  @ms 1_000_000

  defp box(time, track, [x, y, w, h], label \\ "face") do
    values = %{"x" => x, "y" => y, "width" => w, "height" => h, "Label" => label}
    Annotation.new(time * @ms, time * @ms, track, values)
  end

  defp layer(boxes) do
    {:ok, layer} = Layer.new(BoxTracks.build_schema("Boxes", ["face", "hand"]), boxes)
    layer
  end

  defp times, do: for(n <- 0..10, do: n * 40 * @ms)

  test "MOT has a line for each image between the key frames" do
    layer = layer([box(40, "1", [0, 0, 10, 10]), box(120, "1", [20, 0, 10, 30], "face")])
    {:ok, text, []} = Exchange.encode(layer, :mot, origin: 0, times: times())

    assert text == """
           2,1,1,1,10,10,1,1,1
           3,1,11.0,1.0,10.0,20.0,1,1,1
           4,1,21,1,10,30,1,1,1
           """

    {:ok, again, []} = Exchange.decode(text, :mot, times: times(), schema: layer.schema)

    assert [%{from: 40_000_000}, %{values: %{"x" => 10.0, "Label" => "face"}}, _] =
             Layer.annotations(again)
  end

  test "CVAT marks key frames, and ends a track" do
    layer = layer([box(0, "Ada & co", [0, 0, 10, 10]), box(80, "Ada & co", [20, 0, 10, 30])])
    {:ok, text, []} = Exchange.encode(layer, :cvat, origin: 0, times: times())

    assert text =~
             ~s(<box frame="1" keyframe="0" outside="0" occluded="0" xtl="10.0" ytl="0.0" xbr="20.0")

    assert text =~ ~s(<box frame="3" keyframe="1" outside="1")
    {:ok, again, []} = Exchange.decode(text, :cvat, schema: layer.schema)
    assert Layer.annotations(again) == Layer.annotations(layer)
  end

  test "files of other programs, and invalid ones" do
    assert {:ok, layer, []} =
             Exchange.decode("1,3,794.27,247.59,71.24,174.88,-1,-1,-1,-1\n", :mot)

    assert [%{track: "3", from: 0, confidence: nil}] = Layer.annotations(layer)
    assert {:error, %{code: :bad_file, why: why}} = Exchange.decode("1,3,x\n", :mot)
    assert why =~ "is not a box"

    cvat = """
    <annotations><track id="0" label="hand"><box frame="2" keyframe="1" outside="0" xtl="1" ytl="2" xbr="4" ybr="6"/>
    <points frame="3" points="1,2"/><box frame="x" keyframe="1" outside="0"/></track></annotations>
    """

    assert {:ok, layer, losses} = Exchange.decode(cvat, :cvat)

    assert [%{from: 80_000_000, values: %{"width" => 3, "Label" => "hand"}}] =
             Layer.annotations(layer)

    assert length(losses) == 2
    assert {:error, %{code: :bad_file}} = Exchange.decode("<x/>", :cvat)
  end

  property "CVAT keeps key frames, and both formats reject or read altered text", numtests: 60 do
    number = integer(0, 500)
    boxes = list({integer(0, 10), one_of(["a", "b"]), number, number, one_of(["face", "hand"])})

    forall {items, at, byte} <- {boxes, integer(0, 5_000), integer(0, 255)} do
      layer =
        items
        |> Enum.uniq_by(fn {n, track, _, _, _} -> {n, track} end)
        |> Enum.map(fn {n, track, x, y, label} -> box(n * 40, track, [x, y, 5, y + 1], label) end)
        |> layer()

      {:ok, text, []} = Exchange.encode(layer, :cvat, origin: 0, times: times())
      {:ok, again, []} = Exchange.decode(text, :cvat, schema: layer.schema)

      plain = fn l ->
        l
        |> Layer.annotations()
        |> Enum.map(&{&1.from, &1.track, BoxTracks.position(&1)})
        |> Enum.sort()
      end

      assert plain.(again) == plain.(layer)

      for format <- [:cvat, :mot] do
        {:ok, text, _} = Exchange.encode(layer, format, origin: 0, times: times())
        at = rem(at, byte_size(text) + 1)

        altered =
          binary_part(text, 0, at) <> <<byte>> <> binary_part(text, at, byte_size(text) - at)

        case Exchange.decode(altered, format) do
          {:ok, %Layer{}, losses} -> assert is_list(losses)
          {:error, %Situ.Error{}} -> :ok
        end
      end

      true
    end
  end
end
