defmodule Situ.Cluster.GuideTest do
  # Runs the guide's Elixir blocks in order; a block that ends in `# => value` must return that value.
  use ExUnit.Case, async: false

  @guide Path.expand("../../../../../docs/guides/from-one-machine-to-ten.md", __DIR__)

  @tag :tmp_dir
  @tag :capture_log
  test "every block of the guide runs and returns the value it shows", %{tmp_dir: folder} do
    on_exit(fn -> if pid = Process.whereis(Situ.Cluster.Agent), do: Process.exit(pid, :kill) end)
    assert Situ.Test.GuideRunner.run_blocks(@guide, bindings: [folder: folder]) == 4
  end
end
