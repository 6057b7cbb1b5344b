defmodule Situ.Infer.FaceTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.Face
end
