defmodule Situ.Infer.Segmentation do
  @own [
    path: [type: :string, required: true, doc: "The ONNX file."],
    output: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The output with a score for each class and pixel, `{1, classes, height, width}`; `nil`: the only one."
    ],
    side: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "The picture's side, where the file leaves it free."
    ],
    model_options: [type: :keyword, default: [], doc: "For `Situ.Infer.Model.shared/2`."]
  ]

  @imagenet [mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225], fit: :pad]

  @schema @own ++
            for(
              {key, spec} <- Situ.Infer.Vision.PictureInput.schema(),
              do: {key, Keyword.put(spec, :default, Keyword.get(@imagenet, key, spec[:default]))}
            )

  @moduledoc """
  Which class each place of a picture belongs to, by any network that scores classes for pixels (DeepLab, FCN ...).

  Input `:in` is a `Situ.Image` of an 8-bit format, output `:out` a `:gray8` picture of the network's size whose values
  are the numbers of the likeliest classes (up to 256). With `fit: :pad`, as here unless said otherwise, it covers the
  square around the picture; with `:crop` the square in its middle.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component, inputs: [in: Situ.Image], outputs: [out: Situ.Image], options: @schema

  alias Situ.{Error, Image}
  alias Situ.Infer.{Labels, Model, Onnx}
  alias Situ.Infer.Vision.PictureInput

  defstruct [:opts, :model, :input, :output, :choice]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts}}

  @impl true
  def handle_start(_context, %{opts: opts}) do
    model = Error.unwrap!(Model.shared(opts[:path], opts[:model_options]))
    output = Error.unwrap!(Labels.output(model, opts[:output]))
    picture = Keyword.take(opts, Keyword.keys(PictureInput.schema()))
    input = Error.unwrap!(PictureInput.new(model, picture, opts[:side]))
    choice = Error.unwrap!(choice(model, output))
    {[], %__MODULE__{opts: opts, model: model, input: input, output: output, choice: choice}}
  end

  @impl true
  def handle_message(:in, %{data: image, originating_time: time}, _context, state) do
    {:ok, tensor, _patch} = ok!(PictureInput.tensor(state.input, image))
    outputs = Error.unwrap!(Model.run(state.model, %{state.input.name => tensor}))

    %{"classes" => classes} =
      Error.unwrap!(Model.run(state.choice, %{"scores" => outputs[state.output]}))

    {_, height, width} = classes.shape

    {[{:out, time, Image.new!(width: width, height: height, format: :gray8, data: classes.data)}],
     state}
  end

  @impl true
  def describe(%{model: nil}), do: "not started"
  def describe(%{model: model}), do: Model.describe(model)

  defp ok!({:error, error}), do: raise(error)
  defp ok!(fine), do: fine

  # The largest of millions of numbers: work for the library that made them.
  defp choice(model, output) do
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
           why: "wanted is f32 {1, classes, height, width}, with 256 classes at most",
           fix: "name the output by output:"
         )}
    end
  end
end
