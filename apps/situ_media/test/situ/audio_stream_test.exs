defmodule Situ.AudioStreamTest do
  use ExUnit.Case, async: true
  doctest Situ.AudioStream
end
