defmodule Situ.CLI.ClosedPipeTest do
  use ExUnit.Case, async: true
  # A check in test/cli verifies that a closed pipe causes no message.
  doctest Situ.CLI.ClosedPipe
end
