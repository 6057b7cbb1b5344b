defmodule Situ.Infer.ObjectDetector do
  @moduledoc """
  Detects objects in images, with a YOLO network in an ONNX file.

      found = Situ.via(pictures, Situ.Infer.ObjectDetector, path: "yolov8n.onnx", labels: "coco.txt")
      found.out |> Situ.via(Situ.Infer.Tracker)

  Input `:in` is a `Situ.Image` of an 8-bit format. Output `:out` is a list of `Situ.Rect` in image pixels with label
  and score, most likely first. With `masks:`, output `:masks` is a list of `:gray8` images, one for each box, with 255
  where the object is; a mask covers its box. A v2 network needs `scale: 1`. `version:` is the output format of the
  network:

  | version | output | a box | score |
  |---|---|---|---|
  | `:v2_tiny` | `{1, 125, 13, 13}` | an anchor moved and stretched in a cell of 32 pixels (VOC) | object x softmax |
  | `:v5` (v7) | `{1, n, 5 + classes}` | middle and size | object x class |
  | `:v8` (v9, v11) | `{1, 4 + classes (+ masks), n}` | middle and size | class |
  | `:v10` | `{1, n, 6}` | two corners, score, class; already without overlaps | as given |

  No weights are bundled. Check the licence of the weights you use (many YOLO weights are AGPL-3.0).
  """

  @own [
    path: [type: :string, required: true, doc: "The ONNX file."],
    version: [
      type: {:in, Situ.Infer.Detection.Yolo.supported_versions()},
      default: :v8,
      doc: "The output format of the network, see the table above."
    ],
    labels: [
      type: {:or, [:string, {:list, :string}]},
      default: [],
      doc: "The names of the classes in order, or a text file with one name per line."
    ],
    min_score: [type: {:range, 0.0, 1.0}, default: 0.3, doc: "The minimum score of a box."],
    max_overlap: [
      type: {:range, 0.0, 1.0},
      default: 0.5,
      doc:
        "The overlap (intersection over union) above which only the better of two boxes of one class is kept."
    ],
    most: [type: :pos_integer, default: 100, doc: "The maximum number of boxes."],
    output: [
      type: {:optional, :string},
      default: nil,
      doc: "The output with the boxes; `nil` uses the only output."
    ],
    masks: [
      type: {:optional, :string},
      default: nil,
      doc: "The output with the mask prototypes, for networks that also segment objects (v8-seg)."
    ],
    model_options: [
      type: :keyword,
      default: [],
      doc: "Options for `Situ.Infer.Model.load_shared/2`."
    ]
  ]

  @schema @own ++ Situ.Infer.Vision.ImageInput.schema(fit: :pad)

  use Situ.Component,
    inputs: [in: Situ.Image],
    outputs: [out: {:list, Situ.Rect}, masks: {:list, Situ.Image}],
    options: @schema

  alias Situ.{Error, Image, Rect}
  alias Situ.Infer.Detection.{Masks, Yolo}
  alias Situ.Infer.{Labels, Model, Patch, Suppression}
  alias Situ.Infer.Vision.{HalfToFloat, ImageInput}

  defstruct [:opts, :model, :input, :output, :half_converter, :labels, :masks]

  @doc "Returns a function that finds the objects in an image and their masks, for programs without pipelines."
  @spec load(keyword()) ::
          {:ok, (Image.t() -> {:ok, {[Rect.t()], [Image.t()]}} | {:error, Error.t()})}
          | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, state} <- open_model(Map.new(opts)),
         do: {:ok, &detect_objects(state, &1)}
  end

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(_context, state), do: {[], state.opts |> open_model() |> Error.unwrap!()}

  @impl true
  def handle_message(:in, %{data: image, originating_time: time}, _context, state) do
    {rects, masks} = Error.unwrap!(detect_objects(state, image))
    {[{:out, time, rects} | if(state.masks, do: [{:masks, time, masks}], else: [])], state}
  end

  @impl true
  def describe(state), do: Model.describe_runs(state.model)

  defp open_model(opts) do
    with {:ok, model} <- Model.load_shared(opts.path, opts.model_options),
         {:ok, labels} <- Labels.load_names(opts.labels),
         {:ok, output} <- Labels.choose_output(model, opts.output),
         {:ok, masks} <- open_masks(model, opts.masks),
         :ok <- check_output_shape(model, output, opts.version, mask_count(masks)),
         {:ok, half_converter} <- HalfToFloat.new(model.outputs[output]),
         {:ok, input} <- ImageInput.new(model, Keyword.new(opts)) do
      {:ok,
       %__MODULE__{
         opts: opts,
         model: model,
         input: input,
         output: output,
         half_converter: half_converter,
         labels: labels,
         masks: masks
       }}
    end
  end

  defp open_masks(_model, nil), do: {:ok, nil}

  defp open_masks(model, name) do
    with {:ok, name} <- Labels.choose_output(model, name),
         {type, shape} = model.outputs[name],
         do: Masks.new(shape, type)
  end

  defp mask_count(nil), do: 0
  defp mask_count(masks), do: masks.count

  defp check_output_shape(model, output, version, mask_count) do
    {type, shape} = model.outputs[output]

    if type in [:f32, :f16] and Yolo.shape_matches?(version, shape, mask_count) do
      :ok
    else
      {:error,
       Error.new(
         :model_shape,
         "output #{inspect(output)} of #{model.name} is #{type} #{inspect(shape)}",
         why: "YOLO #{version} has outputs of another shape",
         fix: "choose another version:, or another output:"
       )}
    end
  end

  defp detect_objects(state, image) do
    %{opts: opts, input: input} = state

    with {:ok, tensor, patch} <- ImageInput.to_tensor(input, image),
         {:ok, outputs} <- Model.run(state.model, %{input.name => tensor}),
         {:ok, found} <- HalfToFloat.to_floats(state.half_converter, outputs[state.output]) do
      boxes =
        found
        |> Yolo.parse_boxes(opts.version, opts.min_score / 1, mask_count(state.masks))
        |> Suppression.suppress_boxes(opts.max_overlap, opts.most)

      rects = Enum.map(boxes, &to_image_rect(&1, patch, image, state.labels))
      with {:ok, masks} <- cut_masks(state, boxes, outputs), do: {:ok, {rects, masks}}
    end
  end

  defp cut_masks(%{masks: nil}, _boxes, _outputs), do: {:ok, []}

  defp cut_masks(state, boxes, outputs),
    do: Masks.cut_masks(state.masks, boxes, outputs[state.opts.masks], state.input.side)

  # Converts network pixels to image pixels, and clips the rectangle to the image.
  defp to_image_rect(box, patch, image, labels) do
    {x0, y0} = Patch.to_image_point(patch, {box.x - 0.5, box.y - 0.5})
    {x1, y1} = Patch.to_image_point(patch, {box.x + box.width - 0.5, box.y + box.height - 0.5})
    {x0, x1} = {clamp(x0 + 0.5, image.width), clamp(x1 + 0.5, image.width)}
    {y0, y1} = {clamp(y0 + 0.5, image.height), clamp(y1 + 0.5, image.height)}

    %Rect{
      x: x0,
      y: y0,
      width: x1 - x0,
      height: y1 - y0,
      label: Labels.class_name(labels, box.class),
      score: box.score
    }
  end

  defp clamp(v, most), do: v |> max(0.0) |> min(most / 1)
end
