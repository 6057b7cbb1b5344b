defmodule Situ.OrtexTest do
  use ExUnit.Case, async: true

  alias Situ.Infer.Model
  alias Situ.Tensor

  @model Path.expand("../../../apps/situ_infer/priv/models/face_landmark.onnx", __DIR__)

  test "a model has the same inputs, outputs and results as with Situ's own engine" do
    {:ok, own} = Model.load(@model)
    {:ok, ortex} = Model.load(@model, engine: Situ.Ortex)
    assert {ortex.inputs, ortex.outputs} == {own.inputs, own.outputs}

    inputs =
      for {name, {type, shape}} <- own.inputs, into: %{} do
        numbers = for i <- 1..Tensor.element_count(shape), do: rem(i, 255) / 255
        {name, Tensor.from_list(numbers, type, shape)}
      end

    {:ok, expected} = Model.run(own, inputs)
    {:ok, results} = Model.run(ortex, inputs)

    for {name, tensor} <- expected,
        {a, b} <- Enum.zip(Tensor.to_list(tensor), Tensor.to_list(results[name])),
        do: assert_in_delta(a, b, 1.0e-4)
  end

  test "a file that is no model is an error" do
    path = Path.join(System.tmp_dir!(), "situ_ortex_test.onnx")
    File.write!(path, "text")
    assert {:error, %Situ.Error{}} = Model.load(path, engine: Situ.Ortex)
  end

  test "types that are no tensors are not supported" do
    tensor = "Tensor {\n    ty: Float32,\n    dimensions: [\n        -1,\n        3,\n    ],\n}"
    assert Situ.Ortex.port_spec({"x", tensor, [-1, 3]}) == {"x", :f32, {-1, 3}}
    assert Situ.Ortex.port_spec({"x", "Sequence(...)", nil}) == {"x", :unsupported, {}}
  end
end
