defmodule Situ.CLI.PluginTest do
  # Compiles a module into this VM.
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

  test "a new plug-in is listed by its folder, and everywhere in the user's", %{tmp_dir: dir} do
    assert {0, text} = run(["new", "desk-lamp", "--in", dir])
    assert text =~ "desk-lamp/plugin.json"
    assert {0, text} = run(["list", Path.join(dir, "desk-lamp")])
    assert text =~ "visualizer desk-lamp/recent" and text =~ "module DeskLamp.Magnitude"
    assert {0, text} = run(["list"])
    assert text =~ "There are no plug-ins"
    File.mkdir_p!(Path.join(dir, "config/situ/plugins"))
    File.cp_r!(Path.join(dir, "desk-lamp"), Path.join(dir, "config/situ/plugins/broken"))
    File.write!(Path.join(dir, "config/situ/plugins/broken/plugin.json"), "[]")
    assert {1, json} = run(["list", "--json"])
    assert {:ok, [%{"id" => "broken", "problem" => problem}]} = Situ.JSON.decode(json)
    assert problem =~ "must begin with"
  end

  test "a name that is none is refused, and a folder that is there", %{tmp_dir: dir} do
    for name <- ["Desk Lamp", "../lamp", "ö"] do
      assert capture_io(:stderr, fn -> assert Situ.CLI.run(["plugin", "new", name]) == 1 end) =~
               "is no name of a plug-in"
    end

    File.mkdir_p!(Path.join(dir, "there"))
    argv = ["plugin", "new", "there", "--in", dir]
    assert capture_io(:stderr, fn -> assert Situ.CLI.run(argv) == 1 end) =~ "is there already"
  end

  test "other commands warn of what is broken, and go on", %{tmp_dir: dir} do
    File.mkdir_p!(Path.join(dir, "config/situ/plugins/torn"))
    File.write!(Path.join(dir, "config/situ/plugins/torn/plugin.json"), "{")

    assert capture_io(:stderr, fn ->
             assert {0, _} = with_io(fn -> Situ.CLI.run(["task", "list"]) end)
           end) =~ "the plug-in torn is broken"
  end
end
