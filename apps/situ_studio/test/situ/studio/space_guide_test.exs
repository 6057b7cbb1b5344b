defmodule Situ.Studio.SpaceGuideTest do
  # Runs the blocks of docs/guides/space.md and compares the results they show.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../../../docs/guides/space.md", __DIR__)
  @external_resource @guide

  @tag :tmp_dir
  test "runs every block of the guide", %{tmp_dir: folder} do
    assert Situ.Test.GuideRunner.run_blocks(@guide, bindings: [folder: folder]) >= 8
  end
end
