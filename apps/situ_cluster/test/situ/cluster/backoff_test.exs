defmodule Situ.Cluster.BackoffTest do
  use ExUnit.Case, async: true
  doctest Situ.Cluster.Backoff
end
