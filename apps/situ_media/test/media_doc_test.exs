defmodule Situ.MediaDocTest do
  use ExUnit.Case, async: true
  doctest Situ.Image
  doctest Situ.Image.Format
  doctest Situ.Image.Geometry
  doctest Situ.Image.Color
  doctest Situ.Image.Pixels
  doctest Situ.Image.Filter
  doctest Situ.Image.Drawing
  doctest Situ.Image.Measure
  doctest Situ.Image.Files
  doctest Situ.AudioFormat
  doctest Situ.AudioBuffer
  doctest Situ.Audio
  doctest Situ.Vision
  doctest Situ.Audio.Channels
  doctest Situ.Audio.Level
  doctest Situ.Audio.Resampler
  doctest Situ.Audio.Analyzer
  doctest Situ.DepthImage
  doctest Situ.EncodedImage
  doctest Situ.Rect
  doctest Situ.Point2
  doctest Situ.Point3
end
