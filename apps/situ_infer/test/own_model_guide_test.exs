defmodule Situ.Infer.OwnModelGuideTest do
  # Runs the guide's Elixir blocks in order; a block that ends in `# => value` must return that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/your-own-model.md", __DIR__)

  test "every block of your-own-model.md runs and returns the value it shows" do
    assert Situ.Test.GuideRunner.run_blocks(@guide) == 4
  end
end
