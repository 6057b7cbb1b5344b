defmodule Situ.Annotation.RecordingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  import Situ.Annotation.Test.Annotating
  alias Situ.Annotation.{Layer, Recording}
  alias Situ.Store

  @moduletag :tmp_dir

  property "loads layers as they were stored, with their schemas", numtests: 30 do
    forall {one, two} <- {spans(), spans()} do
      root = Path.join(System.tmp_dir!(), "situ-layers-#{System.unique_integer([:positive])}")
      layers = %{"One" => layer(one), "Two" => layer(two)}
      {:ok, path} = Recording.write_all(layers, Path.join(root, "a"))
      store = Store.open!(path)

      for {name, layer} <- layers do
        {:ok, again} = Recording.load_layer(store, name)
        assert Layer.annotations(again) == Layer.annotations(layer)
        assert again.schema == layer.schema
        {:ok, info} = Store.stream_info(store, name)
        assert Recording.annotation_stream?(store, info)
      end

      File.rm_rf!(root)
    end
  end

  test "writes a version each time, and rejects other streams", %{tmp_dir: root} do
    {:ok, first} = Recording.write(layer([{0, 5, "A", "speaks"}]), Path.join(root, "a"), "Speech")
    {:ok, second} = Recording.write(layer([]), Path.join(root, "a"), "Speech")
    assert {Path.basename(first), Path.basename(second)} == {"a.0000", "a.0001"}
    {:ok, [_]} = Recording.read_annotations(Store.open!(first), "Speech")
    {:ok, []} = Recording.read_annotations(Store.open!(second), "Speech")

    {:ok, writer} = Store.Writer.create("numbers", root)
    {:ok, stream} = Store.Writer.stream(writer, "N", type: :integer)
    message = %Situ.Message{data: 5, originating_time: 1, creation_time: 1, sequence_id: 1}
    {:ok, _} = Store.Writer.append(stream, [message])
    :ok = Store.Writer.close(writer)
    store = Store.open!(writer.path)
    {:ok, info} = Store.stream_info(store, "N")
    refute Recording.annotation_stream?(store, info)
    assert {:error, %Situ.Error{}} = Recording.load_layer(store, "N")
    assert {:error, %{code: :no_stream}} = Recording.load_layer(store, "none")
  end
end
