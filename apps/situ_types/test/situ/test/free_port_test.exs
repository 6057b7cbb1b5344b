defmodule Situ.Test.FreePortTest do
  use ExUnit.Case, async: true

  doctest Situ.Test.FreePort
end
