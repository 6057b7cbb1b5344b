defmodule Situ.TypeTest do
  use ExUnit.Case, async: true
  doctest Situ.Type
end
