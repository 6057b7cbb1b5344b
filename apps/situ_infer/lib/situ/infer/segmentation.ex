defmodule Situ.Infer.Segmentation do
  @moduledoc """
  Classifies each pixel of an image with any network that scores classes for pixels (DeepLab, FCN ...).

  Input `:in` is a `Situ.Image` of an 8-bit format. Output `:out` is a `:gray8` image of the network's size whose values
  are the numbers of the most likely classes (up to 256). With `fit: :pad`, the default here, it covers the square
  around the image; with `:crop`, the square in its middle.
  """

  alias Situ.Infer.Vision.ImageInput

  @own [
    path: [type: :string, required: true, doc: "The ONNX file."],
    output: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The output with a score per class and pixel, `{1, classes, height, width}`; `nil` uses the only output."
    ],
    model_options: [
      type: :keyword,
      default: [],
      doc: "Options for `Situ.Infer.Model.load_shared/2`."
    ]
  ]

  @schema @own ++ ImageInput.schema([fit: :pad] ++ ImageInput.imagenet_options())

  use Situ.Component, inputs: [in: Situ.Image], outputs: [out: Situ.Image], options: @schema

  alias Situ.{Error, Image}
  alias Situ.Infer.{Labels, Model, Onnx}

  defstruct [:opts, :model, :input, :output, :choice]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts}}

  @impl true
  def handle_start(_context, %{opts: opts}) do
    model = Error.unwrap!(Model.load_shared(opts[:path], opts[:model_options]))
    output = Error.unwrap!(Labels.choose_output(model, opts[:output]))
    input = Error.unwrap!(ImageInput.new(model, opts))
    choice = Error.unwrap!(build_argmax(model, output))
    {[], %__MODULE__{opts: opts, model: model, input: input, output: output, choice: choice}}
  end

  @impl true
  def handle_message(:in, %{data: image, originating_time: time}, _context, state) do
    {:ok, tensor, _patch} = ok_or_raise!(ImageInput.to_tensor(state.input, image))
    outputs = Error.unwrap!(Model.run(state.model, %{state.input.name => tensor}))

    %{"classes" => classes} =
      Error.unwrap!(Model.run(state.choice, %{"scores" => outputs[state.output]}))

    {_, height, width} = classes.shape

    {[{:out, time, Image.new!(width: width, height: height, format: :gray8, data: classes.data)}],
     state}
  end

  @impl true
  def describe(state), do: Model.describe_runs(state.model)

  defp ok_or_raise!({:error, error}), do: raise(error)
  defp ok_or_raise!(fine), do: fine

  # ONNX Runtime chooses the best class of each pixel too, since there may be millions of numbers.
  defp build_argmax(model, output) do
    case model.outputs[output] do
      {:f32, {_, classes, _, _}} when classes in -1..256 ->
        Onnx.encode(
          inputs: [{"scores", :f32, {1, nil, nil, nil}}],
          outputs: [{"classes", :u8, {1, nil, nil}}],
          nodes: [
            {"ArgMax", ["scores"], ["best"], [axis: 1, keepdims: 0]},
            {"Cast", ["best"], ["classes"], [to: 2]}
          ]
        )
        |> Model.from_bytes("segmentation", warm_up: 0, sessions: 1)

      {type, shape} ->
        {:error,
         Error.new(
           :model_shape,
           "output #{inspect(output)} of #{model.name} is #{type} #{inspect(shape)}",
           why: "it must be f32 {1, classes, height, width}, with at most 256 classes",
           fix: "give the name of the score output as output:"
         )}
    end
  end
end
