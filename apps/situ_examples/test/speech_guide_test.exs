defmodule Situ.Examples.SpeechGuideTest do
  # Runs the guide's Elixir blocks in order; a block that ends in `# => value` must return that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/speech.md", __DIR__)
  @moduletag [timeout: 240_000, moonshine: true]

  test "every block of speech.md runs and returns the value it shows" do
    assert Situ.Test.GuideRunner.run_blocks(@guide) == 5
  end
end
