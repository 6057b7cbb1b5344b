defmodule Situ.Link.PositionTest do
  use ExUnit.Case, async: true
  doctest Situ.Link.Position
end
