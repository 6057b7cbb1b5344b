defmodule Situ.OperatorsDocTest do
  use ExUnit.Case, async: true
  doctest Situ.Interpolator
  doctest Situ.Reproducible
  doctest Situ.Available
  doctest Situ.Fusion.Core
  doctest Situ.Fusion.Zip
  doctest Situ.Window.ByIndex
  doctest Situ.Window.ByTime
  doctest Situ.Statistics
  doctest Situ.Filter.Fir
  doctest Situ.Filter.Iir
  doctest Situ.Filter.OneEuro
  doctest Situ.Test
  doctest Situ.Branch
end
