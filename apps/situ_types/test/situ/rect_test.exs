defmodule Situ.RectTest do
  use ExUnit.Case, async: true
  doctest Situ.Rect
end
