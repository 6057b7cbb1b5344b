defmodule Situ.CLI.Run.SummaryTest do
  use ExUnit.Case, async: true
  doctest Situ.CLI.Run.Summary
end
