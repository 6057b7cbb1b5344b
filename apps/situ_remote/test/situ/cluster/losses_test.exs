defmodule Situ.Cluster.LossesTest do
  use ExUnit.Case, async: true
  doctest Situ.Cluster.Losses
end
