defmodule Situ.Examples.ModelsGuideTest do
  # Runs the guide's Elixir blocks in order; a block that ends in `# => value` must return that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/models.md", __DIR__)
  @moduletag timeout: 240_000

  test "every block of models.md runs and returns the value it shows" do
    assert Situ.Test.GuideRunner.run_blocks(@guide) > 6
  end
end
