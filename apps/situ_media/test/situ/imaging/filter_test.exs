defmodule Situ.Imaging.FilterTest do
  use ExUnit.Case, async: true
  doctest Situ.Imaging.Filter
end
