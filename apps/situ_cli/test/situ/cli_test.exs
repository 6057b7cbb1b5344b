defmodule Situ.CLITest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  doctest Situ.CLI

  test "help lists every command" do
    help = capture_io(fn -> assert Situ.CLI.run(["--help"]) == 0 end)
    assert help =~ "Usage: situ COMMAND"
    for command <- Situ.CLI.Commands.all(), do: assert(help =~ command.name())
  end

  test "no command is wrong usage" do
    assert capture_io(fn -> assert Situ.CLI.run([]) == 2 end) =~ "Usage"
  end

  test "an unknown command says so and exits with 2" do
    message = capture_io(:stderr, fn -> assert Situ.CLI.run(["stroe"]) == 2 end)
    assert message =~ ~s(no command "stroe")
  end

  test "every command documents itself" do
    for command <- Situ.CLI.Commands.all() do
      usage = capture_io(fn -> assert Situ.CLI.run([command.name(), "--help"]) == 0 end)
      assert usage =~ "situ #{command.name()}"
      assert command.summary() != ""
    end
  end
end
