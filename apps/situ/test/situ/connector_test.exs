defmodule Situ.ConnectorTest do
  use ExUnit.Case, async: true
  doctest Situ.Connector
end
