defmodule Situ.ErrorTest do
  use ExUnit.Case, async: true
  doctest Situ.Error
end
