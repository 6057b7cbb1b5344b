defmodule Situ.CLI do
  @moduledoc """
  The `situ` command line: finds the command, runs it, turns its answer into an exit status.

      $ bin/situ --help
      $ bin/situ store info recordings/lobby.0000

  Exit status: 0 done, 1 the command failed and said why on standard error, 2 wrong usage.

  Commands are modules that implement `Situ.CLI.Command`; `Situ.CLI.Commands` lists them.
  """
  alias Situ.CLI.Commands

  @doc "Runs the command line `argv` and ends the VM with its exit status."
  @spec main([String.t()]) :: no_return()
  def main(argv) do
    status = run(argv)
    System.halt(status)
  end

  @doc """
  Runs the command line `argv` and returns its exit status.

      iex> ExUnit.CaptureIO.capture_io(fn -> Situ.CLI.run(["--version"]) end) =~ "situ 0."
      true
  """
  @spec run([String.t()]) :: 0..255
  def run([]), do: help(2)
  def run([flag | _]) when flag in ["--help", "-h", "help"], do: help(0)

  def run([flag | _]) when flag in ["--version", "-v", "version"] do
    IO.puts("situ #{version()} (Elixir #{System.version()}, OTP #{System.otp_release()})")
    0
  end

  def run([name | argv]) do
    case Commands.fetch(name) do
      {:ok, command} -> run_command(command, argv)
      {:error, error} -> fail(error, 2)
    end
  end

  @doc "This version of Situ."
  @spec version() :: String.t()
  def version, do: to_string(Application.spec(:situ_cli, :vsn) || "0.1.0")

  defp run_command(command, argv) do
    if Enum.any?(argv, &(&1 in ["--help", "-h"])) do
      IO.puts(command.usage())
      0
    else
      command.run(argv)
    end
  rescue
    # The border to the user: an expected failure is a sentence, not a stacktrace.
    error in Situ.Error ->
      fail(error, 1)

    # Whoever read what is printed has enough of it (`situ ... | head`): the status of a program that writes to nobody.
    error in ErlangError ->
      if error.original == :terminated, do: 141, else: reraise(error, __STACKTRACE__)
  end

  defp fail(error, status) do
    IO.puts(:stderr, "situ: " <> Exception.message(error))
    status
  end

  defp help(status) do
    width = Commands.all() |> Enum.map(&String.length(&1.name())) |> Enum.max(fn -> 0 end)

    commands =
      Enum.map_join(Commands.all(), "\n", fn command ->
        "  #{String.pad_trailing(command.name(), width)}   #{command.summary()}"
      end)

    IO.puts("""
    Situ records, replays and shows streams of what was seen and heard.

    Usage: situ COMMAND [ARGUMENTS]

    #{commands}

      --version   print the version
      --help      this text; `situ COMMAND --help` explains one command
    """)

    status
  end
end
