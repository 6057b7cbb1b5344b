defmodule Situ.Cluster.PastTest do
  use ExUnit.Case, async: true
  doctest Situ.Cluster.Past
end
