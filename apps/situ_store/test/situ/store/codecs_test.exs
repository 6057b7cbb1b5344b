defmodule Situ.Store.CodecsTest do
  use ExUnit.Case, async: true
  alias Situ.Store.Codecs

  test "a codec is found by its name alone, also one of Situ's own types" do
    assert Codecs.find("situ.image", nil) == Situ.Image
    assert Codecs.find("situ.image", "Elixir.Situ.Gone.Since") == Situ.Image
    assert Codecs.find("nobody.has.this", nil) == nil
  end
end
