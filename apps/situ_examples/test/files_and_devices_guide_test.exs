defmodule Situ.Examples.FilesAndDevicesGuideTest do
  # Not async: the guide uses relative file names, so the test changes the VM's current folder.
  use ExUnit.Case, async: false

  @moduletag :tmp_dir
  @moduletag :capture_log

  @root Path.expand("../../..", __DIR__)
  @guide Path.join(@root, "docs/guides/files-and-devices.md")
  @talk Path.join(@root, "apps/situ_media/test/fixtures/talk1.mp4")

  test "every snippet of the guide runs in order", %{tmp_dir: dir} do
    File.cp!(@talk, Path.join(dir, "talk1.mp4"))
    before = File.cwd!()
    on_exit(fn -> File.cd!(before) end)
    File.cd!(dir)

    assert Situ.Test.GuideRunner.run_blocks(@guide) >= 8
  end
end
