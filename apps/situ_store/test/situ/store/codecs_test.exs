defmodule Situ.Store.CodecsTest do
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.{Person, Picture, Sound}
  alias Situ.Store.{Codecs, Undecoded}

  @moduletag :tmp_dir

  test "finds a codec by its name alone, including codecs of Situ's own types" do
    assert Codecs.find_module("situ.image", nil) == Situ.Image
    assert Codecs.find_module("situ.image", "Elixir.Situ.Gone.Since") == Situ.Image
    assert Codecs.find_module("nobody.has.this", nil) == nil
  end

  test "an unknown codec returns the bytes", %{tmp_dir: root} do
    path = store(root, [{"P", messages([%Picture{width: 9, data: "abc"}]), []}])
    store = Store.open!(path)
    {:ok, info} = Store.stream_info(store, "P")
    gone = %{info | codecs: %{1 => {"nobody.knows", "Elixir.Nobody.Knows"}}}

    assert {:ok, %{data: %Undecoded{codec: "nobody.knows", bytes: <<9::little-32, "abc">>}}} =
             Store.at(store, gone, 0)
  end

  test "finds a codec by its module or by its own name" do
    assert Codecs.module_for(%Picture{}) == Picture
    assert Codecs.module_for(%Person{}) == nil
    assert Codecs.module_for(5) == nil
    assert Codecs.find_module("test.sound", "Elixir.Situ.Store.Test.Sound") == Sound
    # The module now has a different codec, is not a codec, or never existed.
    refute Codecs.find_module("test.sound", "Elixir.Situ.Store.Test.Picture") == Picture
    assert Codecs.find_module("nobody.knows", "Elixir.Situ.Store.Test.Person") == nil
    assert Codecs.find_module("nobody.knows", "Elixir.Nobody.Knows.This.Module") == nil

    assert_raise ArgumentError, fn ->
      String.to_existing_atom("Elixir.Nobody.Knows.This.Module")
    end
  end
end
