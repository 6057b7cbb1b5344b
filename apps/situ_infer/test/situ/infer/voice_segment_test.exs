defmodule Situ.Infer.VoiceSegmentTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.VoiceSegment
end
