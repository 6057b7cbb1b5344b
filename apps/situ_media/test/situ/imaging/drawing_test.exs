defmodule Situ.Imaging.DrawingTest do
  use ExUnit.Case, async: true
  doctest Situ.Imaging.Drawing
end
