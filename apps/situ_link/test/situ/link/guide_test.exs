defmodule Situ.Link.GuideTest do
  # Runs the guide's Elixir blocks in order; a block that ends in `# => value` must return that value.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog

  @guide Path.expand("../../../../../docs/guides/links.md", __DIR__)

  test "every block of the guide runs and returns the value it shows" do
    capture_log(fn -> assert Situ.Test.GuideRunner.run_blocks(@guide) > 5 end)
  end
end
