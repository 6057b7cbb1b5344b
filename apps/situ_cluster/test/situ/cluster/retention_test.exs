defmodule Situ.Cluster.RetentionTest do
  use ExUnit.Case, async: true
  doctest Situ.Cluster.Retention
end
