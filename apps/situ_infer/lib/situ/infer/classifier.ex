defmodule Situ.Infer.Classifier do
  @moduledoc """
  Classifies images with any ONNX network that gives a score for each class, such as the networks trained on ImageNet.

      pictures |> Situ.via(Situ.Infer.Classifier, path: "resnet50-v2.onnx", labels: "synset.txt", softmax: true)

  Input `:in` is a `Situ.Image` of an 8-bit format or `nil`. Output `:out` is the list of the most likely classes,
  `{label, score}`, best first (`nil` for `nil`). By default the preprocessing is ImageNet's: the middle square,
  bilinear, `(v / 255 - mean) / std`. The label of a class without a name is its number.
  """

  alias Situ.Infer.Vision.ImageInput

  @own [
    path: [type: :string, required: true, doc: "The ONNX file."],
    labels: [
      type: {:or, [:string, {:list, :string}]},
      default: [],
      doc: "The names of the classes in order, or a text file with one name per line."
    ],
    top: [
      type: :pos_integer,
      default: 5,
      doc: "The number of classes to return, most likely first."
    ],
    softmax: [
      type: :boolean,
      default: false,
      doc: "Whether the network returns raw scores that softmax must convert to probabilities."
    ],
    output: [
      type: {:optional, :string},
      default: nil,
      doc: "The output with the scores; `nil` uses the only output."
    ],
    model_options: [
      type: :keyword,
      default: [],
      doc: "Options for `Situ.Infer.Model.load_shared/2`."
    ]
  ]

  @schema @own ++ ImageInput.schema(ImageInput.imagenet_options())

  use Situ.Component,
    inputs: [in: {:optional, Situ.Image}],
    outputs: [out: {:optional, {:list, {:tuple, [:string, :float]}}}],
    options: @schema

  alias Situ.{Error, Image, Tensor}
  alias Situ.Infer.{Activation, Labels, Model}

  defstruct [:opts, :model, :input, :output, :labels]

  @type class :: {label :: String.t(), score :: float()}

  @doc "Returns a function that classifies images without a pipeline. See the options above."
  @spec load(keyword()) ::
          {:ok, (Image.t() -> {:ok, [class()]} | {:error, Error.t()})} | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, state} <- open_model(opts),
         do: {:ok, &classify_image(state, &1)}
  end

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts}}

  @impl true
  def handle_start(_context, state), do: {[], state.opts |> open_model() |> Error.unwrap!()}

  @impl true
  def handle_message(:in, %{data: nil, originating_time: time}, _context, state),
    do: {[{:out, time, nil}], state}

  def handle_message(:in, %{data: image, originating_time: time}, _context, state),
    do: {[{:out, time, Error.unwrap!(classify_image(state, image))}], state}

  @impl true
  def describe(state), do: Model.describe_runs(state.model)

  defp open_model(opts) do
    with {:ok, model} <- Model.load_shared(opts[:path], opts[:model_options]),
         {:ok, labels} <- Labels.load_names(opts[:labels]),
         {:ok, output} <- Labels.choose_output(model, opts[:output]),
         {:ok, input} <- ImageInput.new(model, opts) do
      {:ok, %__MODULE__{opts: opts, model: model, input: input, output: output, labels: labels}}
    end
  end

  defp classify_image(state, image) do
    with {:ok, tensor, _patch} <- ImageInput.to_tensor(state.input, image),
         {:ok, outputs} <- Model.run(state.model, %{state.input.name => tensor}),
         :ok <- check_scores(outputs[state.output], state),
         do: {:ok, top_classes(outputs[state.output], state.labels, state.opts)}
  end

  defp check_scores(scores, state) do
    if Enum.all?(Tensor.to_list(scores), &is_number/1),
      do: :ok,
      else:
        {:error,
         Error.new(:bad_scores, "model #{state.model.name} returned scores that are not numbers",
           why:
             "NaN or infinite values come from a broken model, or from images that are not scaled as it expects",
           fix: "check mean:, std: and scale:, and try the model with another image"
         )}
  end

  @doc """
  Returns the best-scoring classes. `opts` are `top:` and `softmax:`.

      iex> scores = Situ.Tensor.from_list([1.0, 3.0, 2.0], :f32, {1, 3})
      iex> Situ.Infer.Classifier.top_classes(scores, {"cat", "dog"}, top: 2)
      [{"dog", 3.0}, {"2", 2.0}]
  """
  @spec top_classes(Tensor.t(), tuple(), keyword()) :: [class()]
  def top_classes(%Tensor{} = scores, labels, opts) do
    values = Tensor.to_list(scores)
    values = if opts[:softmax], do: Activation.softmax(values), else: values

    values
    |> Enum.with_index()
    |> Enum.sort_by(fn {score, index} -> {-score, index} end)
    |> Enum.take(opts[:top])
    |> Enum.map(fn {score, index} -> {Labels.class_name(labels, index), score} end)
  end
end
