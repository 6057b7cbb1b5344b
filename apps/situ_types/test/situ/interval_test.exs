defmodule Situ.IntervalTest do
  use ExUnit.Case, async: true
  doctest Situ.Interval
end
