defmodule Situ.CLI.AnnotateTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Annotation, Message, Store}
  alias Situ.Annotation.{Layer, Recording, Schema}

  @moduletag :tmp_dir

  defp boxes(root) do
    numbers = for name <- ~w(x y width height), do: %{"name" => name, "kind" => "number"}
    {:ok, schema} = Schema.parse(%{"name" => "Box", "attributes" => numbers})
    values = &%{"x" => &1, "y" => 0, "width" => 10, "height" => 10}
    keys = [Annotation.new(100, 100, "A", values.(0)), Annotation.new(300, 300, "A", values.(20))]
    {:ok, layer} = Layer.new(schema, keys)
    {:ok, path} = Recording.write(layer, Path.join(root, "boxes"), "Box")
    path
  end

  defp film(root) do
    {:ok, writer} = Store.Writer.create("film", root)
    {:ok, stream} = Store.Writer.stream(writer, "Video", type: :integer)

    messages =
      for i <- 1..4,
          do: %Message{data: i, originating_time: i * 100, creation_time: i * 100, sequence_id: i}

    {:ok, _} = Store.Writer.append(stream, messages)
    :ok = Store.Writer.close(writer)
    writer.path
  end

  defp bboxes(file) do
    {:ok, %{"annotations" => annotations}} = file |> File.read!() |> Situ.JSON.decode()
    for a <- annotations, do: hd(a["bbox"])
  end

  test "exports COCO boxes of key frames, or of every image of a stream", %{tmp_dir: root} do
    {path, file} = {boxes(root), Path.join(root, "b.coco.json")}
    assert {0, ""} = with_io(fn -> Situ.CLI.run(["annotate", "export", path, file]) end)
    assert bboxes(file) == [0, 20]

    argv = [
      "annotate",
      "export",
      path,
      file,
      "--media-of",
      film(root),
      "--pictures",
      "Video",
      "--json"
    ]

    assert {0, said} = with_io(fn -> Situ.CLI.run(argv) end)
    assert {:ok, %{"losses" => [_], "annotations" => 2}} = Situ.JSON.decode(said)
    assert bboxes(file) == [0, 10, 20]

    said =
      capture_io(:stderr, fn ->
        assert Situ.CLI.run(["annotate", "export", path, file, "--pictures", "V"]) == 2
      end)

    assert said =~ "--media-of"
  end
end
