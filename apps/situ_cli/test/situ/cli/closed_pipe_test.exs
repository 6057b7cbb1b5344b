defmodule Situ.CLI.ClosedPipeTest do
  use ExUnit.Case, async: true
  # That a pipe really closed says nothing is a check of test/cli.
  doctest Situ.CLI.ClosedPipe
end
