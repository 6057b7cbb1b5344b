defmodule Situ.Remote.GuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog

  @guide Path.expand("../../../../docs/guides/links.md", __DIR__)

  test "every block of the guide runs and gives what it says" do
    capture_log(fn -> assert Situ.Test.Guide.run(@guide) > 5 end)
  end
end
