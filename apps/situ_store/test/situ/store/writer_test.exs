defmodule Situ.Store.WriterTest do
  use ExUnit.Case, async: true
  alias Situ.Store
  alias Situ.Store.Test.{Picture, Sound}
  alias Situ.Store.Writer
  import Situ.Store.Test.Record, only: [message: 2]

  doctest Situ.Store.Writer

  @moduletag :tmp_dir

  test "an append of several kinds of messages writes all of them or none", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("mixed", root)
    {:ok, stream} = Writer.stream(writer, "S")
    picture = %Picture{width: 3, data: <<1, 2, 3>>}
    sound = %Sound{samples: Enum.to_list(1..16)}
    bad = [message(picture, 1), message(sound, 2), message(self(), 3)]
    assert {:error, %{code: :not_storable}} = Writer.append(stream, bad)
    late = [message(picture, 5), message("text", 6), message(picture, 6)]
    assert {:error, %{code: :not_increasing}} = Writer.append(stream, late)
    store = Store.open!(writer.path)
    assert Store.count(store, "S") == 0
    good = [message(picture, 1), message("text", 2), message(7, 3), message(picture, 4)]
    assert {:ok, stream} = Writer.append(stream, good)
    assert {:ok, _} = Writer.append(stream, [message(sound, 5)])
    :ok = Writer.close(writer)
    data = for m <- Store.messages(Store.open!(writer.path), "S"), do: m.data
    assert data == [picture, "text", 7, picture, sound]
  end

  test "refuses metadata that cannot be read back", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("meta", root)
    {:ok, stream} = Writer.stream(writer, "S")
    assert {:error, %{code: :not_storable, what: what}} = Writer.put_metadata(stream, self())
    assert what =~ "process id"
    assert :ok = Writer.put_metadata(stream, %{"unit" => "m"})
    :ok = Writer.close(writer)
    assert {:ok, %{"unit" => "m"}} = Store.metadata(Store.open!(writer.path), "S")
  end
end
