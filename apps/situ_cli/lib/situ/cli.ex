defmodule Situ.CLI do
  @moduledoc false
  # The `situ` command line: finds the verb, parses its arguments, runs it and returns an exit
  # status.
  #
  #     $ bin/situ --help
  #     $ bin/situ store info recordings/lobby.0000
  #
  # Exit status: 0 success; 1 the command failed and reported why on standard error, or found
  # damage or differences; 2 wrong usage; 130 stopped by Ctrl-C; 141 the reader of a pipe closed
  # it.
  #
  # Verbs are tables (`Situ.CLI.Verb`), which `situ completion` and `situ manual` use as well.
  alias Situ.CLI.{Commands, Help, Output, Parser, Plugin}

  @version Mix.Project.config()[:version]

  # Plug-ins add file formats and tasks to these commands.
  @extended ~w(store dataset task query annotate)

  @doc "Runs the command line that the VM was started with, then stops the VM with the exit status."
  @spec start() :: no_return()
  def start do
    # Elixir's own start script rejects bytes that are not UTF-8, but file names may contain them.
    {:ok, _} = Application.ensure_all_started(:elixir)
    main(Enum.map(:init.get_plain_arguments(), &decode_argument/1))
  end

  defp decode_argument({kind, read, rest}) when kind in [:incomplete, :error],
    do: IO.iodata_to_binary([List.to_string(read), rest])

  defp decode_argument(characters) do
    case :unicode.characters_to_binary(characters) do
      text when is_binary(text) -> text
      {_, read, rest} -> IO.iodata_to_binary([read, rest])
    end
  end

  @doc "Runs the command line `argv` and stops the VM with the exit status."
  @spec main([String.t()]) :: no_return()
  def main(argv) do
    Situ.CLI.ClosedPipe.silence_reports()
    status = run(argv)
    System.halt(status)
  end

  @doc """
  Runs the command line `argv` and returns its exit status.

      iex> ExUnit.CaptureIO.capture_io(fn -> Situ.CLI.run(["--version"]) end) =~ "situ 1."
      true
  """
  @spec run([String.t()]) :: 0..255
  def run(argv), do: rescue_errors(fn -> dispatch(argv) end)

  defp dispatch([]), do: show_help(2)
  defp dispatch([flag]) when flag in ["--help", "-h", "help"], do: show_help(0)
  defp dispatch(["help" | words]), do: dispatch(words ++ ["--help"])

  defp dispatch([flag | _]) when flag in ["--version", "-v", "version"] do
    IO.puts("situ #{version()} (Elixir #{System.version()}, OTP #{System.otp_release()})")
    0
  end

  defp dispatch([flag | _]) when flag in ["--help", "-h"], do: show_help(0)

  defp dispatch(argv) do
    case Commands.find_verb(argv) do
      {:ok, verb, rest} -> parse_and_run(verb, rest)
      {:group, word, verbs} -> show_group(word, verbs, argv)
      {:error, error} -> report_error(error, 2)
    end
  end

  defp show_group(word, verbs, argv) do
    IO.write(Help.format_group(word, Commands.groups()[word] || word, verbs))
    if length(argv) > 1, do: 0, else: 2
  end

  defp parse_and_run(verb, argv) do
    case Parser.parse(verb, argv) do
      {:ok, arguments, options} ->
        run_verb(verb, arguments, options)

      :help ->
        IO.write(Help.format_verb(verb))
        0

      {:error, why} ->
        report_usage_error(verb, why)
    end
  end

  # A verb throws `{:usage, why}` for errors that the parser cannot detect from the verb's table.
  defp run_verb(verb, arguments, options) do
    Enum.each(
      [:situ_examples | Application.spec(:situ_cli, :applications) || []],
      &load_application/1
    )

    if hd(verb.words) in @extended, do: Plugin.load_plugins([])
    verb.run.(arguments, options)
  catch
    :throw, {:usage, why} -> report_usage_error(verb, why)
  end

  # Recordings may contain structs of any Situ application, but only structs of loaded applications can be read.
  defp load_application(app) do
    if String.starts_with?(to_string(app), "situ") and Application.load(app) == :ok,
      do: Enum.each(Application.spec(app, :applications), &load_application/1)
  end

  defp report_usage_error(verb, why) do
    name = Enum.join(verb.words, " ")
    Output.warn("situ #{name}: #{why}\n  Fix: see `situ #{name} --help`")
    2
  end

  @doc "Returns the version of Situ."
  @spec version() :: String.t()
  def version, do: @version

  # Users see an expected failure as a sentence, not as a stack trace.
  defp rescue_errors(work) do
    work.()
  rescue
    error in Situ.Error ->
      report_error(error, 1)

    # The reader of the output closed it (`situ ... | head`), so exit with the status of a broken pipe.
    error in ErlangError ->
      if Map.get(error, :original) == :terminated,
        do: 141,
        else: report_crash(error, __STACKTRACE__)

    error ->
      report_crash(error, __STACKTRACE__)
  catch
    :exit, :terminated ->
      141
  end

  defp report_error(error, status) do
    Output.warn("situ: " <> Exception.message(error))
    status
  end

  # The error is a bug in Situ, so print everything that a bug report needs.
  defp report_crash(error, stack) do
    Output.warn("situ: this is a bug in Situ: #{Exception.format_banner(:error, error, stack)}")

    if System.get_env("SITU_DEBUG") in [nil, ""],
      do: Output.warn("  Fix: report it, with the output of `SITU_DEBUG=1 situ ...`"),
      else: Output.warn(Exception.format_stacktrace(stack))

    1
  end

  defp show_help(status) do
    IO.write(Help.format_overview(Commands.list_verbs(), Commands.groups()))
    status
  end
end
