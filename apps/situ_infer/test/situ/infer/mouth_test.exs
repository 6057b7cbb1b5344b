defmodule Situ.Infer.MouthTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.Mouth
end
