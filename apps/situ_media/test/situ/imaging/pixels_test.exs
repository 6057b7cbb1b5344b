defmodule Situ.Imaging.PixelsTest do
  use ExUnit.Case, async: true
  doctest Situ.Imaging.Pixels
end
