defmodule Situ.ImageOps.DrawingTest do
  use ExUnit.Case, async: true
  doctest Situ.ImageOps.Drawing
end
