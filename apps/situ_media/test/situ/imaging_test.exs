defmodule Situ.ImagingTest do
  use ExUnit.Case, async: true
  doctest Situ.Imaging
end
