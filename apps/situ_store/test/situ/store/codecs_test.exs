defmodule Situ.Store.CodecsTest do
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.{Person, Picture, Sound}
  alias Situ.Store.{Codecs, Undecoded}

  @moduletag :tmp_dir

  test "a codec is found by its name alone, also one of Situ's own types" do
    assert Codecs.find("situ.image", nil) == Situ.Image
    assert Codecs.find("situ.image", "Elixir.Situ.Gone.Since") == Situ.Image
    assert Codecs.find("nobody.has.this", nil) == nil
  end

  test "an unknown codec gives the bytes", %{tmp_dir: root} do
    path = store(root, [{"P", messages([%Picture{width: 9, data: "abc"}]), []}])
    store = Store.open!(path)
    {:ok, info} = Store.stream_info(store, "P")
    gone = %{info | codecs: %{1 => {"nobody.knows", "Elixir.Nobody.Knows"}}}

    assert {:ok, %{data: %Undecoded{codec: "nobody.knows", bytes: <<9::little-32, "abc">>}}} =
             Store.at(store, gone, 0)
  end

  test "a codec is found by the module named, or by its own name" do
    assert Codecs.of(%Picture{}) == Picture
    assert Codecs.of(%Person{}) == nil
    assert Codecs.of(5) == nil
    assert Codecs.find("test.sound", "Elixir.Situ.Store.Test.Sound") == Sound
    # A module that has another codec now, one that is none, one that was never there.
    refute Codecs.find("test.sound", "Elixir.Situ.Store.Test.Picture") == Picture
    assert Codecs.find("nobody.knows", "Elixir.Situ.Store.Test.Person") == nil
    assert Codecs.find("nobody.knows", "Elixir.Nobody.Knows.This.Module") == nil

    assert_raise ArgumentError, fn ->
      String.to_existing_atom("Elixir.Nobody.Knows.This.Module")
    end
  end
end
