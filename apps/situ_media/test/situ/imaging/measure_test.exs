defmodule Situ.Imaging.MeasureTest do
  use ExUnit.Case, async: true
  doctest Situ.Imaging.Measure
end
