defmodule Situ.AudioStream.ResamplerTest do
  use ExUnit.Case, async: true
  doctest Situ.AudioStream.Resampler
end
