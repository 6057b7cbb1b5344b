defmodule Situ.Live.GuideTest do
  # Defines the guide's modules and starts its server.
  use ExUnit.Case, async: false

  @guide Path.expand("../../../../../docs/guides/live-views.md", __DIR__)
  @external_resource @guide

  test "the snippets of the guide run in order" do
    Process.flag(:trap_exit, true)
    assert Situ.Test.GuideRunner.run_blocks(@guide) == 3
  end
end
