defmodule Situ.Audio.LevelTest do
  use ExUnit.Case, async: true
  doctest Situ.Audio.Level
end
