defmodule Situ.GuidesTest do
  # The Elixir blocks of the guides run, one after the other; a block that ends in `# => value` gives that value. The
  # pictures are what their script draws.
  use ExUnit.Case, async: true
  alias Situ.Test.Guide

  @guides Path.expand("../../../docs/guides", __DIR__)

  for guide <- ["fusing-streams.md"] do
    @tag :capture_log
    test "every block of #{guide} runs and gives what it says" do
      assert Guide.run(Path.join(@guides, unquote(guide))) > 5
    end
  end

  test "the pictures of the guide are drawn from what the operators give" do
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
