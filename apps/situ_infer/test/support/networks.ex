defmodule Situ.Infer.Test.Networks do
  @moduledoc false
  # Networks that tests write themselves: small, real, and with results that can be computed by hand.
  alias Situ.Infer.Onnx
  alias Situ.Tensor

  @doc "Returns the mean of red, green and blue as the scores of three classes."
  def colours(side) do
    Onnx.encode(
      inputs: [{"picture", :f32, {nil, 3, side, side}}],
      outputs: [{"scores", :f32, {nil, 3}}],
      nodes: [
        {"GlobalAveragePool", ["picture"], ["means"], []},
        {"Flatten", ["means"], ["scores"], [axis: 1]}
      ]
    )
  end

  @doc "Returns scores that are not numbers: zero divided by zero."
  def undefined(side) do
    Onnx.encode(
      inputs: [{"picture", :f32, {nil, 3, side, side}}],
      outputs: [{"scores", :f32, {nil, 3}}],
      nodes: [
        {"GlobalAveragePool", ["picture"], ["means"], []},
        {"Flatten", ["means"], ["flat"], [axis: 1]},
        {"Sub", ["flat", "flat"], ["none"], []},
        {"Div", ["none", "none"], ["scores"], []}
      ]
    )
  end

  @doc "Returns three classes for each pixel: the brightest channel is the likeliest."
  def brightest(side) do
    Onnx.encode(
      inputs: [{"picture", :f32, {1, 3, side, side}}],
      outputs: [{"scores", :f32, {1, 3, side, side}}],
      nodes: [{"Identity", ["picture"], ["scores"], []}]
    )
  end

  @doc "Finds the same for every input: outputs by name, given as tensors."
  def finding(side, outputs) do
    Onnx.encode(
      inputs: [{"picture", :f32, {1, 3, side, side}}],
      outputs: for({name, tensor} <- outputs, do: {name, :f32, tensor.shape}),
      constants:
        for(
          {name, tensor} <- outputs,
          into: %{"no" => Tensor.from_list([0.0], :f32, {1})},
          do: {"is_" <> name, tensor}
        ),
      nodes:
        [
          {"ReduceMean", ["picture"], ["mean"], [keepdims: 0]},
          {"Mul", ["mean", "no"], ["nothing"], []}
        ] ++
          for({name, _} <- outputs, do: {"Add", ["is_" <> name, "nothing"], [name], []})
    )
  end

  @doc "Computes z = x + y in rows of `width`."
  def adding(width) do
    port = &{&1, :f32, {nil, width}}

    Onnx.encode(
      inputs: [port.("x"), port.("y")],
      outputs: [port.("z"), port.("twice")],
      nodes: [{"Add", ["x", "y"], ["z"], []}, {"Add", ["z", "z"], ["twice"], []}]
    )
  end

  @doc "Writes the network to a folder and returns its path."
  def write(bytes, dir, name \\ "network.onnx") do
    path = Path.join(dir, name)
    File.write!(path, bytes)
    path
  end
end
