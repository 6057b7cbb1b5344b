# The landmarks of a face, by Situ's model in Ortex and in Situ's own engine. Run it with: mix run examples/face.exs
path = Path.expand("../../../apps/situ_infer/priv/models/face_landmark.onnx", __DIR__)
{:ok, model} = Situ.Infer.Model.load(path, engine: Situ.Ortex)
{:ok, own} = Situ.Infer.Model.load(path)
IO.inspect(model.inputs, label: "inputs")
IO.inspect(model.outputs, label: "outputs")

inputs =
  for {name, {type, shape}} <- model.inputs, into: %{} do
    numbers = for i <- 1..Situ.Tensor.element_count(shape), do: rem(i, 255) / 255
    {name, Situ.Tensor.from_list(numbers, type, shape)}
  end

{:ok, results} = Situ.Infer.Model.run(model, inputs)
{:ok, expected} = Situ.Infer.Model.run(own, inputs)
IO.puts("the results are equal: #{results == expected}")
