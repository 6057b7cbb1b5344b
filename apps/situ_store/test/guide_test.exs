defmodule Situ.Store.GuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/recording-and-replaying.md", __DIR__)

  test "every block runs and gives what it says" do
    assert Situ.Test.Guide.run(@guide) > 8
  end
end
