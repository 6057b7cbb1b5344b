defmodule Situ.ImageOps.MeasureTest do
  use ExUnit.Case, async: true
  doctest Situ.ImageOps.Measure
end
