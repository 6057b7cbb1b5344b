defmodule Situ.DoctestsTest do
  use ExUnit.Case, async: true
  import Situ.Test.Examples

  doctest Situ.Test.Examples

  test "every operator and interpolator has a doctest" do
    for module <- [Situ, Situ.Reproducible, Situ.Available],
        do: assert(list_missing(module) == [])
  end
end
