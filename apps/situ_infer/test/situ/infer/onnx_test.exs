defmodule Situ.Infer.OnnxTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.Onnx
end
