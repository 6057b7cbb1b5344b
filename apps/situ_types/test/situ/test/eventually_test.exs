defmodule Situ.Test.EventuallyTest do
  use ExUnit.Case, async: true
  doctest Situ.Test.Eventually
  import Situ.Test.Eventually

  test "polls until the condition is true" do
    counter = :counters.new(1, [])
    seen = fn -> :counters.add(counter, 1, 1) == :ok and :counters.get(counter, 1) == 4 end
    assert eventually(seen)
    assert :counters.get(counter, 1) == 4
  end
end
