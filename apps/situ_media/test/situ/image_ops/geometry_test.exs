defmodule Situ.ImageOps.GeometryTest do
  use ExUnit.Case, async: true
  doctest Situ.ImageOps.Geometry
end
