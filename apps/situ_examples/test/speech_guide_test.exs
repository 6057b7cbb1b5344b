defmodule Situ.Examples.SpeechGuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/speech.md", __DIR__)
  @moduletag [timeout: 240_000, moonshine: true]

  test "every block of speech.md runs and gives what it says" do
    assert Situ.Test.Guide.run(@guide) == 5
  end
end
