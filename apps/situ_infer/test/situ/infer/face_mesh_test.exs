defmodule Situ.Infer.FaceMeshTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.FaceMesh
end
