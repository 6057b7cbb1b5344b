defmodule Situ.Diagnostics.SourceTest do
  use ExUnit.Case, async: true

  alias Situ.Component.Context
  alias Situ.Diagnostics.Source

  test "a tick that comes after the stop's snapshot gives nothing" do
    # As fast as possible, a file's time runs ahead of the clock: the stop is stamped with the later one.
    assert Source.handle_info({:timer, :tick}, %Context{now: 8}, {1, 16}) == {[], {1, 16}}
  end
end
