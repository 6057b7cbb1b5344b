defmodule Situ.Examples.DocTest do
  use ExUnit.Case, async: true

  doctest Situ.Examples.Demo.GroundTruth
  doctest Situ.Examples.Demo.Score
end
