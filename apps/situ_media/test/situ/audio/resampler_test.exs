defmodule Situ.Audio.ResamplerTest do
  use ExUnit.Case, async: true
  doctest Situ.Audio.Resampler
end
