defmodule Situ.ApplicationGuideTest do
  # The guide "Situ in your application", done: its files in an empty folder, compiled, tested and run by Mix as a
  # reader would.
  use ExUnit.Case, async: true

  @root Path.expand("../../..", __DIR__)
  @guide Path.join(@root, "docs/guides/situ-in-your-application.md")

  # The shell of the guide is opened later than this.
  @running """
  wait = fn wait ->
    [{_, pipeline, _, _}] = Supervisor.which_children(Doorbell.Supervisor)
    if Situ.Pipeline.state(pipeline) == :running, do: :ok, else: wait.(wait)
  end
  wait.(wait)
  """

  defp blocks(first_line) do
    ~r/^```elixir\n# #{first_line}\n(.*?)^```/ms
    |> Regex.scan(File.read!(@guide), capture: :all_but_first)
  end

  defp mix(dir, args, env) do
    env = [{"MIX_ENV", env}, {"MIX_DEBUG", nil}, {"MIX_BUILD_PATH", nil}, {"ERL_LIBS", nil}]
    System.cmd("mix", args, cd: dir, env: env, stderr_to_stdout: true)
  end

  # Outside of the project: Mix must not take it for a part of this umbrella.
  defp folder do
    dir = Path.join(System.tmp_dir!(), "situ-application-#{System.unique_integer([:positive])}")
    File.mkdir_p!(dir)
    on_exit(fn -> File.rm_rf!(dir) end)
    dir
  end

  @tag timeout: 300_000
  test "its umbrella compiles, passes its tests and runs" do
    dir = folder()

    for [name, code] <- blocks("file: (\\S+)") do
      path = Path.join(dir, name)
      File.mkdir_p!(Path.dirname(path))
      # This checkout stands for the one in vendor/situ.
      File.write!(path, String.replace(code, "../../vendor/situ", @root))
    end

    assert {out, 0} = mix(dir, ["test"], "test")
    # Elixir 1.20 says "Result: 1 passed".
    assert out =~ ~r/^(1 test, 0 failures|Result: 1 passed)/m
    refute out =~ "warning:"

    [[code]] = blocks("run")
    assert {out, 0} = mix(dir, ["run", "-e", @running <> code], "test")
    assert out =~ "Visitors"
  end
end
