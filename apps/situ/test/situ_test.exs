defmodule SituTest do
  use ExUnit.Case, async: true
  doctest Situ
end
