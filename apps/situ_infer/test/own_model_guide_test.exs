defmodule Situ.Infer.OwnModelGuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/your-own-model.md", __DIR__)

  test "every block of your-own-model.md runs and gives what it says" do
    assert Situ.Test.Guide.run(@guide) == 4
  end
end
