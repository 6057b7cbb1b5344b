defmodule Situ.Store.GuideTest do
  # Runs the Elixir blocks of the guide in order; a block that ends in `# => value` must return that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/recording-and-replaying.md", __DIR__)

  test "every block runs and returns the value it shows" do
    assert Situ.Test.GuideRunner.run_blocks(@guide) > 8
  end
end
