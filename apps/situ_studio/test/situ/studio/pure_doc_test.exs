defmodule Situ.Studio.PureDocTest do
  use ExUnit.Case, async: true

  doctest Situ.Studio.Frame
  doctest Situ.Studio.Path
  doctest Situ.Studio.WholeNumber
  doctest Situ.Studio.Export
  doctest Situ.Studio.Coverage
  doctest Situ.Studio.ValueTree
  doctest Situ.Studio.Tree
  doctest Situ.Studio.StreamInfo
  doctest Situ.Studio.Visualizers
  doctest Situ.Studio.Layout
  doctest Situ.Studio.Layout.Auto
  doctest Situ.Studio.History
  doctest Situ.Studio.Draw.Shapes
  doctest Situ.Studio.Draw.Bars
  doctest Situ.Studio.Draw.Bins
  doctest Situ.Studio.Draw.Segments
  doctest Situ.Studio.Draw.Spans
  doctest Situ.Studio.Draw.Lines
  doctest Situ.Studio.Draw.Key
  doctest Situ.Studio.NaturalOrder
end
