defmodule Situ.ImageOps.FilterTest do
  use ExUnit.Case, async: true
  doctest Situ.ImageOps.Filter
end
