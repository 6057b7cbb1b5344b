defmodule Situ.Annotation.Exchange.CocoTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Exchange, Layer, Schema}

  @s 1_000_000_000
  @place ~w(x y width height)

  defp schema do
    numbers = for name <- @place ++ ["age"], do: %{"name" => name, "kind" => "number"}
    values = for value <- ~w(face hand), do: %{"value" => value}
    kind = %{"name" => "Kind", "kind" => "finite", "values" => values}
    {:ok, schema} = Schema.parse(%{"name" => "Things", "attributes" => [kind | numbers]})
    schema
  end

  defp box(time, track, [x, y, w, h], more \\ []) do
    values = %{"x" => x, "y" => y, "width" => w, "height" => h, "Kind" => "hand", "age" => 3}
    Annotation.new(time, time, track, values, more)
  end

  defp layer(annotations) do
    {:ok, layer} = Layer.new(schema(), annotations)
    layer
  end

  defp plain(layer), do: for(a <- Layer.annotations(layer), do: %{a | id: nil})

  test "writes COCO boxes, and the other attributes next to them" do
    a = box(5 * @s, "Anna", [10, 20, 30.5, 40], by: "ada", confidence: 0.5, note: "left")
    b = box(7 * @s, "Ben", [1, 2, 3, 4], proposed?: true)
    {:ok, text, []} = Exchange.encode(layer([a, b]), :coco)
    {:ok, json} = Situ.JSON.decode(text)

    assert [%{"id" => 1, "name" => "face"}, %{"id" => 2, "name" => "hand"}] = json["categories"]
    assert [%{"id" => 1, "time_ns" => 5_000_000_000}, %{"id" => 2}] = json["images"]

    assert [
             %{
               "id" => 1,
               "image_id" => 1,
               "category_id" => 2,
               "bbox" => [10, 20, 30.5, 40],
               "area" => 1220.0
             },
             %{"id" => 2, "image_id" => 2, "track" => "Ben", "iscrowd" => 0}
           ] = json["annotations"]

    assert {:ok, again, []} = Exchange.decode(text, :coco)
    assert plain(again) == plain(layer([a, b]))
    assert again.schema == schema()
  end

  property "decodes boxes as they were encoded" do
    number = one_of([integer(0, 4_000), float(0.0, 4_000.0)])
    items = list({integer(0, 100), one_of(["P1", "Ü<&"]), number, number, number, number})

    forall items <- items do
      boxes =
        for {t, track, x, y, w, h} <- Enum.uniq_by(items, &{elem(&1, 0), elem(&1, 1)}),
            do: box(t * 40, track, [x, y, w, h])

      layer = layer(boxes)
      {:ok, text, []} = Exchange.encode(layer, :coco)
      {:ok, again, []} = Exchange.decode(text, :coco, schema: schema())
      assert plain(again) == plain(layer)
    end
  end

  test "writes a box for each image between key frames if times are given" do
    layer = layer([box(0, "A", [0, 0, 10, 10]), box(4 * @s, "A", [40, 8, 10, 30])])
    times = for k <- -1..6, do: k * @s
    {:ok, text, [loss]} = Exchange.encode(layer, :coco, times: times)
    assert loss =~ "key frames"
    {:ok, json} = Situ.JSON.decode(text)

    assert for(a <- json["annotations"], do: a["bbox"]) ==
             for(k <- 0..4, do: [k * 10, k * 2, 10, 10 + k * 5])
  end

  test "reports annotations that have a duration or are not boxes" do
    lasting = %{box(0, "A", [1, 1, 1, 1]) | to: 2 * @s}
    {:ok, text, [loss]} = Exchange.encode(layer([lasting]), :coco)
    assert loss =~ "1 annotations with a duration are only at their start"
    {:ok, %{"annotations" => [%{"bbox" => [1, 1, 1, 1]}]}} = Situ.JSON.decode(text)
    {:ok, text, _} = Exchange.encode(layer([lasting]), :coco, times: [-1, 0, @s, 3 * @s])
    {:ok, %{"annotations" => [_, _]}} = Situ.JSON.decode(text)

    {:ok, words} =
      Layer.new(Schema.text("Words"), [Annotation.new(0, 1, "A", %{"Words" => "hi"})])

    assert {:ok, _, ["COCO stores only boxes: 1 annotations without" <> _]} =
             Exchange.encode(words, :coco)
  end

  test "reads files of other programs" do
    file = %{
      "images" => [
        %{"id" => 8, "file_name" => "b.jpg", "width" => 640, "height" => 480},
        %{"id" => 9, "file_name" => "a.jpg"}
      ],
      "categories" => [%{"id" => 18, "name" => "dog"}],
      "annotations" => [
        %{"id" => 1, "image_id" => 8, "category_id" => 18, "bbox" => [1, 2, 3, 4], "area" => 12},
        %{"id" => 2, "image_id" => 8, "category_id" => 18, "bbox" => [5, 6, 7, 8]},
        %{"id" => 3, "image_id" => 77, "category_id" => 18, "bbox" => [1, 2, 3, 4]},
        %{"id" => 4, "image_id" => 9, "category_id" => 18, "bbox" => "large"}
      ]
    }

    {:ok, layer, losses} = Exchange.decode(Situ.JSON.encode(file), :coco)

    assert [
             %{from: 1_000_000_000, track: "dog", values: %{"Label" => "dog", "x" => 1}},
             %{track: "dog (2)"}
           ] = Layer.annotations(layer)

    assert [
             "2 images have no time" <> _,
             "2 annotations are not boxes" <> _,
             "1 annotations overlap" <> _
           ] = losses
  end

  property "rejects or reads altered text, and never raises", numtests: 200 do
    {:ok, text, _} =
      Exchange.encode(layer([box(0, "A", [1, 2, 3, 4]), box(9, "B", [1, 2, 3, 4])]), :coco)

    forall {at, byte, cut} <- {integer(0, byte_size(text) - 1), integer(0, 255), integer(0, 300)} do
      <<before::binary-size(at), _, rest::binary>> = text
      short = binary_part(text, 0, max(byte_size(text) - cut, 0))

      for bytes <- [before <> <<byte>> <> rest, short] do
        case Exchange.decode(bytes, :coco) do
          {:ok, %Layer{}, _} -> true
          {:error, %Situ.Error{}} -> true
        end
      end
    end
  end

  test "detects the format by extension" do
    assert Exchange.detect_format("x/boxes.COCO.json") == {:ok, :coco}
    assert Exchange.detect_format("x/boxes.json") == {:ok, :label_studio}
    {:ok, text, _} = Exchange.encode(layer([box(0, "A", [1, 2, 3, 4])]), :coco)
    assert {:error, %{why: "it is a COCO file" <> _}} = Exchange.decode(text, :label_studio)
  end
end
