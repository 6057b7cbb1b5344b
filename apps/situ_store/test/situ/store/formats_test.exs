defmodule Situ.Store.FormatsTest do
  use ExUnit.Case, async: true
  doctest Situ.Store.Formats
end
