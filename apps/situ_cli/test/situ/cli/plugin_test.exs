defmodule Situ.CLI.PluginTest do
  # Not async, because it compiles a module into this VM.
  use ExUnit.Case, async: false
  import ExUnit.CaptureIO

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    before = System.get_env("XDG_CONFIG_HOME")
    System.put_env("XDG_CONFIG_HOME", Path.join(dir, "config"))

    on_exit(fn ->
      if before,
        do: System.put_env("XDG_CONFIG_HOME", before),
        else: System.delete_env("XDG_CONFIG_HOME")
    end)
  end

  defp run(argv), do: with_io(fn -> Situ.CLI.run(["plugin" | argv]) end)

  test "lists a new plug-in in its folder, and installed ones everywhere", %{tmp_dir: dir} do
    assert {0, text} = run(["new", "desk-lamp", "--in", dir])
    assert text =~ "desk-lamp/plugin.json"
    assert {0, text} = run(["list", Path.join(dir, "desk-lamp")])
    assert text =~ "visualizer desk-lamp/recent" and text =~ "module DeskLamp.Magnitude"
    assert {0, text} = run(["list"])
    assert text =~ "No plug-ins found"
    File.mkdir_p!(Path.join(dir, "config/situ/plugins"))
    File.cp_r!(Path.join(dir, "desk-lamp"), Path.join(dir, "config/situ/plugins/broken"))
    File.write!(Path.join(dir, "config/situ/plugins/broken/plugin.json"), "[]")
    assert {1, json} = run(["list", "--json"])
    assert {:ok, [%{"id" => "broken", "problem" => problem}]} = Situ.JSON.decode(json)
    assert problem =~ "must contain"
  end

  test "rejects an invalid name and an existing folder", %{tmp_dir: dir} do
    for name <- ["Desk Lamp", "../lamp", "ö"] do
      assert capture_io(:stderr, fn -> assert Situ.CLI.run(["plugin", "new", name]) == 1 end) =~
               "invalid plug-in name"
    end

    File.mkdir_p!(Path.join(dir, "there"))
    argv = ["plugin", "new", "there", "--in", dir]
    assert capture_io(:stderr, fn -> assert Situ.CLI.run(argv) == 1 end) =~ "already exists"
  end

  test "other commands warn about a broken plug-in and continue", %{tmp_dir: dir} do
    File.mkdir_p!(Path.join(dir, "config/situ/plugins/torn"))
    File.write!(Path.join(dir, "config/situ/plugins/torn/plugin.json"), "{")

    assert capture_io(:stderr, fn ->
             assert {0, _} = with_io(fn -> Situ.CLI.run(["task", "list"]) end)
           end) =~ "the plug-in torn is broken"
  end
end
