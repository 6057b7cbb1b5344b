defmodule Situ.Image.ColorTest do
  use ExUnit.Case, async: true
  doctest Situ.Image.Color
end
