defmodule Situ.ApplicationGuideTest do
  # Follows the guide "Situ in your application" as a reader would: writes its files into an empty folder, then
  # compiles, tests and runs them with Mix.
  use ExUnit.Case, async: true

  @root Path.expand("../../..", __DIR__)
  @guide Path.join(@root, "docs/guides/situ-in-your-application.md")

  # The guide's shell session starts only once the pipeline is running, so wait for that.
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

  # The folder is outside the project so that Mix does not treat it as part of this umbrella.
  defp folder do
    dir = Path.join(System.tmp_dir!(), "situ-application-#{System.unique_integer([:positive])}")
    File.mkdir_p!(dir)
    on_exit(fn -> File.rm_rf!(dir) end)
    dir
  end

  @tag timeout: 300_000
  test "the guide's umbrella compiles, passes its tests and runs" do
    dir = folder()

    for [name, code] <- blocks("file: (\\S+)") do
      path = Path.join(dir, name)
      File.mkdir_p!(Path.dirname(path))
      # This checkout replaces the one in vendor/situ.
      File.write!(path, String.replace(code, "../../vendor/situ", @root))
    end

    assert {out, 0} = mix(dir, ["test"], "test")
    # Elixir 1.20 prints "Result: 1 passed".
    assert out =~ ~r/^(2 tests, 0 failures|Result: 2 passed)/m
    refute out =~ "warning:"

    code = "run" |> blocks() |> Enum.join("\n")
    assert {out, 0} = mix(dir, ["run", "-e", @running <> code], "test")
    assert out =~ "Visitors"
  end
end
