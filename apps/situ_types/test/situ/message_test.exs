defmodule Situ.MessageTest do
  use ExUnit.Case, async: true
  doctest Situ.Message
end
