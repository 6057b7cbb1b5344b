defmodule Situ.Remote.ServerNameTest do
  use ExUnit.Case, async: true
  doctest Situ.Remote.ServerName
end
