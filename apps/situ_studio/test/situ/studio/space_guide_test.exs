defmodule Situ.Studio.SpaceGuideTest do
  # The blocks of docs/guides/space.md run and give what they say.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../../../docs/guides/space.md", __DIR__)
  @external_resource @guide

  @tag :tmp_dir
  test "every block of the guide runs", %{tmp_dir: folder} do
    assert Situ.Test.Guide.run(@guide, bindings: [folder: folder]) >= 8
  end
end
