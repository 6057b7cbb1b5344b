defmodule Situ.Point3Test do
  use ExUnit.Case, async: true
  doctest Situ.Point3
end
