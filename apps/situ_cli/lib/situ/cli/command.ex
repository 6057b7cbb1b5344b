defmodule Situ.CLI.Command do
  @moduledoc """
  One command of the `situ` command line: parse, call the library, print.

  A command answers with its exit status: 0 done, 1 failed (with the reason on standard error), 2 wrong usage. It may
  raise a `Situ.Error`, which is printed and becomes status 1. `--help` is answered by `usage/0` before `run/1` is asked.
  """

  @doc "The word on the command line."
  @callback name() :: String.t()
  @doc "One line for `situ --help`."
  @callback summary() :: String.t()
  @doc "The text of `situ COMMAND --help`: usage, options, exit status, an example."
  @callback usage() :: String.t()
  @doc "Does the work; `argv` excludes the command's name."
  @callback run(argv :: [String.t()]) :: exit_status :: 0..255
end
