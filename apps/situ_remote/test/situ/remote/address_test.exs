defmodule Situ.Remote.AddressTest do
  use ExUnit.Case, async: true
  doctest Situ.Remote.Address
end
