defmodule Situ.Link.ServerNameTest do
  use ExUnit.Case, async: true
  doctest Situ.Link.ServerName
end
