defmodule Situ.Infer.DocTest do
  use ExUnit.Case, async: true

  doctest Situ.Infer.Patch
  doctest Situ.Infer.Face
  doctest Situ.Infer.FaceMesh
  doctest Situ.Infer.FaceTracker
  doctest Situ.Infer.Mouth
  doctest Situ.Infer.SimpleVad
  doctest Situ.Infer.Voice
  doctest Situ.Infer.VoiceGate
  doctest Situ.Infer.VoiceSegment
end
