defmodule Situ.Examples.ModelsGuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/models.md", __DIR__)
  @moduletag timeout: 240_000

  test "every block of models.md runs and gives what it says" do
    assert Situ.Test.Guide.run(@guide) > 6
  end
end
