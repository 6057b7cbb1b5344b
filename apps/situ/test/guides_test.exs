defmodule Situ.GuidesTest do
  # Runs the Elixir blocks of the guides in order; a block that ends in `# => value` must return that value. The
  # images must match the output of their script.
  use ExUnit.Case, async: true
  alias Situ.Test.GuideRunner

  @guides Path.expand("../../../docs/guides", __DIR__)

  for {guide, least} <- [{"fusing-streams.md", 6}, {"operations.md", 2}] do
    @tag :capture_log
    test "every block of #{guide} runs and returns the value it shows" do
      assert GuideRunner.run_blocks(Path.join(@guides, unquote(guide))) >= unquote(least)
    end
  end

  test "the guide's images match the output of the operators" do
    System.put_env("SITU_PICTURES", "test")
    Code.require_file(Path.join(@guides, "fusing-streams/pictures.exs"))
    pictures = apply(Situ.Guide.Pictures, :all, [])
    assert map_size(pictures) == 7

    for {name, svg} <- pictures do
      assert File.read!(Path.join([@guides, "fusing-streams", name])) == svg,
             "#{name} is out of date"
    end
  end
end
