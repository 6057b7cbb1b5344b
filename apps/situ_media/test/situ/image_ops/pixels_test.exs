defmodule Situ.ImageOps.PixelsTest do
  use ExUnit.Case, async: true
  doctest Situ.ImageOps.Pixels
end
