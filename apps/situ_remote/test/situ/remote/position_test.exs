defmodule Situ.Remote.PositionTest do
  use ExUnit.Case, async: true
  doctest Situ.Remote.Position
end
