defmodule Situ.AudioTest do
  use ExUnit.Case, async: true
  doctest Situ.Audio
end
