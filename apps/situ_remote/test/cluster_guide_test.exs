defmodule Situ.ClusterGuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: false

  @guide Path.expand("../../../docs/guides/from-one-machine-to-ten.md", __DIR__)

  @tag :tmp_dir
  @tag :capture_log
  test "every block of the guide runs and gives what it says", %{tmp_dir: folder} do
    on_exit(fn -> if pid = Process.whereis(Situ.Cluster.Agent), do: Process.exit(pid, :kill) end)
    assert Situ.Test.Guide.run(@guide, bindings: [folder: folder]) == 4
  end
end
