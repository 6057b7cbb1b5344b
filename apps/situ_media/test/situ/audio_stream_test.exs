defmodule Situ.AudioStreamTest do
  use ExUnit.Case, async: true
  doctest Situ.AudioStream

  test "every operator has a doctest" do
    assert Situ.Test.Examples.list_missing(Situ.AudioStream) == []
  end
end
