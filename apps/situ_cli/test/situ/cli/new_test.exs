defmodule Situ.CLI.NewTest do
  use ExUnit.Case
  import ExUnit.CaptureIO

  @moduletag :tmp_dir

  defp create(argv), do: with_io(fn -> Situ.CLI.run(["new" | argv]) end)

  defp fail(argv) do
    capture_io(:stderr, fn -> assert Situ.CLI.run(["new" | argv]) in [1, 2] end)
  end

  # `test/project` builds and runs such projects.
  test "creates a project whose files name it", %{tmp_dir: folder} do
    path = Path.join(folder, "night-watch")
    assert {0, output} = create([path])
    assert output =~ "Your project is ready"

    for file <- ~w(mix.exs README.md .formatter.exs .gitignore lib/night_watch.ex),
        do: assert(File.exists?(Path.join(path, file)))

    for file <- Path.wildcard(Path.join(path, "**"), match_dot: true), File.regular?(file) do
      text = File.read!(file)
      refute text =~ "{{", "#{file} has an unknown name in braces"
      refute file =~ "APP"
      if Path.extname(file) in [".ex", ".exs"], do: Code.string_to_quoted!(text)
    end

    assert File.read!(Path.join(path, "lib/night_watch.ex")) =~ "defmodule NightWatch do"

    {:ok, layout} =
      Situ.Studio.Layout.Json.parse_json(File.read!(Path.join(path, "layouts/night_watch.json")))

    assert layout.name == "NightWatch"
  end

  test "copies an example under another name", %{tmp_dir: folder} do
    for example <- Situ.CLI.New.Example.list_names() do
      path = Path.join(folder, "copy-of-#{example}")
      assert {0, output} = create([path, "--example", example])
      assert output =~ "Your project is ready"
      name = "copy_of_" <> example
      assert File.exists?(Path.join(path, "lib/#{name}.ex"))
      module = Macro.camelize(name)
      assert File.read!(Path.join(path, "lib/#{name}.ex")) =~ "defmodule #{module} do"
      mix = File.read!(Path.join(path, "mix.exs"))
      assert mix =~ "app: :#{name}," and mix =~ inspect(Situ.CLI.Checkout.folder())
      refute mix =~ "Path.expand"
      refute File.exists?(Path.join(path, "_build"))
    end

    bag = Path.join(folder, "copy-of-robot_log/priv/drive.bag")
    original = Path.join(Situ.CLI.Checkout.folder(), "examples/robot_log/priv/drive.bag")
    assert File.read!(bag) == File.read!(original)

    path = Path.join(folder, "other")
    assert fail([path, "--example", "robot_logs"]) =~ "did you mean robot_log?"

    assert fail([path, "--example", "robot_log", "--umbrella"]) =~
             "either --umbrella or --example"

    refute File.exists?(path)
  end

  test "writes formatted code", %{tmp_dir: folder} do
    for {argv, name} <- [{[], "lobby"}, {["--umbrella"], "house"}] do
      path = Path.join(folder, name)
      {0, _} = create([path | argv])

      for file <- Path.wildcard(Path.join(path, "**/*.{ex,exs}"), match_dot: true) do
        text = File.read!(file)
        assert IO.iodata_to_binary([Code.format_string!(text), "\n"]) == text, file
      end
    end
  end

  test "overwrites nothing, and refuses invalid names", %{tmp_dir: folder} do
    path = Path.join(folder, "lobby")
    {0, _} = create([path])
    assert fail([path]) =~ "already exists"
    assert fail([Path.join(folder, "My Lobby")]) =~ "such as my-lobby"
    assert fail([Path.join(folder, "situ")]) =~ "is reserved"
    assert fail([]) =~ "PATH is missing"
    assert fail(["--component", "a", "--task", "b"]) =~ "give one of"
    assert File.ls!(folder) == ["lobby"]
  end

  test "adds parts to a project", %{tmp_dir: folder} do
    path = Path.join(folder, "lobby")
    {0, _} = create([path])

    File.cd!(path, fn ->
      assert {0, output} = create(["--component", "blink-detector"])
      assert output =~ "Situ.via(stream, Lobby.BlinkDetector)"
      assert File.read!("test/lobby/blink_detector_test.exs") =~ "Lobby.BlinkDetectorTest"
      assert fail(["--component", "blink-detector"]) =~ "already exists"

      generated = capture_io(fn -> Mix.Tasks.Situ.Gen.Component.run(["yawn-detector"]) end)
      assert generated =~ "Situ.via(stream, Lobby.YawnDetector)"
      assert File.exists?("test/lobby/yawn_detector_test.exs")

      for wrong <- [["yawn-detector"], ["No Name"], [], ["--help"]] do
        assert_raise Mix.Error, fn -> Mix.Tasks.Situ.Gen.Component.run(wrong) end
      end

      assert {0, _} = create(["--task", "loud-parts"])
      assert File.read!("lib/lobby/loud_parts.ex") =~ ~s(name: "loud-parts")
      assert {0, _} = create(["--visualizer", "gaze"])
      assert File.exists?("visualizers/gaze/plugin.json")
    end)

    File.cd!(folder, fn ->
      assert fail(["--component", "x"]) =~ "not the folder of an application"
    end)
  end
end
