defmodule Situ.TimeTest do
  use ExUnit.Case, async: true
  doctest Situ.Time
end
