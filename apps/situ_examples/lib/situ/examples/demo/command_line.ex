defmodule Situ.Examples.Demo.CommandLine do
  @moduledoc false
  # Parses the command lines of `bin/demo`, and prints usage and failures. Functions return the exit status.
  alias Situ.Error

  @typedoc "A command: its name (`bin/demo --scene`), its usage, and the switches of `OptionParser`."
  @type command :: %{name: String.t(), usage: String.t(), switches: keyword()}

  @doc "Calls `fun` with the options of `argv`, unless they are wrong or ask for help. Reports an error that it raises."
  @spec run([String.t()], command(), (keyword() -> 0..255)) :: 0..255
  def run(argv, command, fun) do
    # `elixir -e ... -- args` passes the dashes to the script.
    argv = if List.first(argv) == "--", do: tl(argv), else: argv

    case OptionParser.parse(argv, strict: command.switches, aliases: [h: :help]) do
      {_, _, [{switch, _} | _]} ->
        print_usage_error("unknown or incomplete option #{switch}", command.name)

      {_, [extra | _], _} ->
        print_usage_error("unexpected argument #{inspect(extra)}", command.name)

      {opts, [], []} ->
        if opts[:help], do: print_usage(command.usage), else: fun.(opts)
    end
  rescue
    error in Error -> print_error(error)
  end

  @doc "Prints the usage."
  @spec print_usage(String.t()) :: 0
  def print_usage(usage) do
    IO.puts(usage)
    0
  end

  @doc "Prints what is wrong with a command line."
  @spec print_usage_error(String.t(), String.t()) :: 2
  def print_usage_error(text, name) do
    IO.puts(:stderr, "bin/demo: #{text}\n  Fix: see #{name} --help")
    2
  end

  @doc "Prints an error."
  @spec print_error(Error.t()) :: 1
  def print_error(error), do: print_failure(Exception.message(error))

  @doc "Prints why the demo failed."
  @spec print_failure(String.t()) :: 1
  def print_failure(text) do
    IO.puts(:stderr, "bin/demo: " <> text)
    1
  end
end
