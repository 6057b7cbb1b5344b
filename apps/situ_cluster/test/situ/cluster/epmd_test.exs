defmodule Situ.Cluster.EpmdTest do
  use ExUnit.Case, async: true
  doctest Situ.Cluster.Epmd
end
