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
  doctest Situ.Studio.Visualizer
  doctest Situ.Studio.Visualizers.Line
  doctest Situ.Studio.Annotating
  doctest Situ.Studio.Color
  doctest Situ.Studio.Statistics
  doctest Situ.Studio.Layout
  doctest Situ.Studio.Layout.Auto
  doctest Situ.Studio.History
  doctest Situ.Studio.Visualizers.Shapes
  doctest Situ.Studio.Visualizers.Bars
  doctest Situ.Studio.Draw.Bins
  doctest Situ.Studio.Draw.Rhythm
  doctest Situ.Studio.Draw.Tracks
  doctest Situ.Studio.Draw.Segments
  doctest Situ.Studio.Visualizers.Spans
  doctest Situ.Studio.Visualizers.Lines
  doctest Situ.Studio.Draw.Key
  doctest Situ.Studio.NaturalOrder
  doctest Situ.Studio.Annotating.Shelf
  doctest Situ.Studio.Annotating.SchemaForm
  doctest Situ.Studio.Annotating.Comparison
  doctest Situ.Studio.Finding
  doctest Situ.Studio.Table
  doctest Situ.Studio.Source.Session
  doctest Situ.Studio.Datasets.Place
  doctest Situ.Studio.Datasets.Facts
  doctest Situ.Studio.Batch.Run
  doctest Situ.Studio.Batch.Form
  doctest Situ.Studio.Batch.Configurations
  doctest Situ.Studio.Web.Dataset.Rows
  doctest Situ.Studio.Web.Dataset.Edits
end
