defmodule Situ.Imaging.GeometryTest do
  use ExUnit.Case, async: true
  doctest Situ.Imaging.Geometry
end
