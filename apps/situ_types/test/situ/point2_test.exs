defmodule Situ.Point2Test do
  use ExUnit.Case, async: true
  doctest Situ.Point2
end
