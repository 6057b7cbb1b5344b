defmodule Situ.ImageOpsTest do
  use ExUnit.Case, async: true
  doctest Situ.ImageOps
end
