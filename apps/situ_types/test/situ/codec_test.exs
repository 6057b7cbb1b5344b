defmodule Situ.CodecTest do
  use ExUnit.Case, async: true
  doctest Situ.Codec
end
