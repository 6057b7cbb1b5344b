defmodule Situ.NumberTest do
  use ExUnit.Case, async: true
  doctest Situ.Number
end
