defmodule Situ.Dataset.GuideTest do
  # Runs the Elixir blocks of the guide in order. A block that ends in `# => value` must return
  # that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../../docs/guides/a-study.md", __DIR__)

  test "runs every block of the study with the results it shows" do
    assert Situ.Test.GuideRunner.run_blocks(@guide) > 8
  end
end
