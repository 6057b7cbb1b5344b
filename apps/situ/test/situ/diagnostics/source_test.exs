defmodule Situ.Diagnostics.SourceTest do
  use ExUnit.Case, async: true

  alias Situ.Component.Context
  alias Situ.Diagnostics.Source

  test "a tick after the stop's snapshot emits nothing" do
    # At maximum speed, the times of a file run ahead of the clock; the stop has the later of the two times.
    assert Source.handle_info({:timer, :tick}, %Context{now: 8}, {1, 16}) == {[], {1, 16}}
  end
end
