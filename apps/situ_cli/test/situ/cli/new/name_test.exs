defmodule Situ.CLI.New.NameTest do
  use ExUnit.Case, async: true
  doctest Situ.CLI.New.Name
end
