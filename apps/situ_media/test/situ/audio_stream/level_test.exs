defmodule Situ.AudioStream.LevelTest do
  use ExUnit.Case, async: true
  doctest Situ.AudioStream.Level
end
