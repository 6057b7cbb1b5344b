defmodule Situ.Infer.PersonMask do
  @moduledoc """
  Segments the person in front of the camera (MediaPipe's selfie segmentation).

  Input `:in` is a `Situ.Image` of an 8-bit format. Each image produces a message on each output, at its time:

    * `:out`: a list of one `Situ.Rect` in image pixels, with the label `"person"` and the mean score of its pixels, or
      an empty list;
    * `:masks`: a `:gray8` image for each rectangle, 255 where the person is; a mask covers its box. The studio draws
      both;
    * `:scores`: a `:gray8` image of 256 x 256 that covers the whole input image, whatever its shape. It contains the
      score of each pixel, 0 to 255, for blurring or replacing the background.

        person = Situ.via(pictures, Situ.Infer.PersonMask)
        Situ.Store.write(person.out, store, "Person")
        Situ.Store.write(person.masks, store, "Person.Masks")

  The network was trained on people within 2 m of a camera, from the head to the hips. It segments the foreground:
  several people become one mask, and in an image without people it may mistake an object in the middle for a person.
  One detection takes about 5 ms on one core.

  To use it without a pipeline, see `find_person/2`.
  """

  @schema Situ.Infer.BundledModel.schema() ++
            [
              min_score: [
                type: {:range, 0.01, 0.99},
                default: 0.5,
                doc: "The minimum score of a pixel that belongs to the person."
              ],
              min_share: [
                type: {:range, 0.0, 1.0},
                default: 0.01,
                doc:
                  "The minimum share of the image that a person covers; smaller areas are ignored."
              ]
            ]

  use Situ.Component,
    inputs: [in: Situ.Image],
    outputs: [out: {:list, Situ.Rect}, masks: {:list, Situ.Image}, scores: Situ.Image],
    options: @schema

  alias Situ.{Error, Image, Rect, Tensor}
  alias Situ.Infer.{BundledModel, Model, Onnx, Patch}

  @side 256
  # Ignores specks: a column or row belongs to the box if at least this share of it belongs to the person.
  @speck 0.02
  @ports [
    inputs: %{"input" => {:f32, {1, @side, @side, 3}}},
    outputs: %{"person" => {:f32, {1, @side, @side, 1}}}
  ]

  @typedoc "The person in an image: a box, its mask, and the scores of all pixels."
  @type detection :: %{rects: [Rect.t()], masks: [Image.t()], scores: Image.t()}

  defstruct [:opts, :model, :reader]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts}}

  @impl true
  def handle_start(_context, %{opts: opts}), do: {[], Error.unwrap!(load_models(opts))}

  @impl true
  def handle_message(:in, %{data: image, originating_time: time}, _context, state) do
    detection = Error.unwrap!(segment_image(state, image))

    {[
       {:out, time, detection.rects},
       {:masks, time, detection.masks},
       {:scores, time, detection.scores}
     ], state}
  end

  @impl true
  def describe(state), do: Model.describe_runs(state.model)

  @doc """
  Finds the person in one image, without a pipeline. See the options above. Returns the errors of `Situ.Infer.Model` and
  `:bad_image`.
  """
  @spec find_person(Image.t(), keyword()) :: {:ok, detection()} | {:error, Error.t()}
  def find_person(%Image{} = image, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, state} <- load_models(opts),
         do: segment_image(state, image)
  end

  defp load_models(opts) do
    with {:ok, model} <- BundledModel.load(opts, "person.onnx", @ports),
         {:ok, reader} <-
           Model.from_bytes(encode_reader(), "person mask", warm_up: 0, sessions: 1),
         do: {:ok, %__MODULE__{opts: opts, model: model, reader: reader}}
  end

  # ONNX Runtime evaluates the 65,536 scores too, since that is faster than Elixir.
  defp encode_reader do
    mask_port = fn name -> {name, :u8, {1, @side, @side, 1}} end

    Onnx.encode(
      inputs: [{"person", :f32, {1, @side, @side, 1}}, {"least", :f32, {1}}],
      outputs: [
        mask_port.("scores"),
        mask_port.("mask"),
        {"columns", :f32, {@side}},
        {"rows", :f32, {@side}},
        {"sum", :f32, {1}}
      ],
      constants: %{"white" => Tensor.from_list([255.0], :f32, {1})},
      nodes: [
        {"Greater", ["person", "least"], ["inside"], []},
        {"Cast", ["inside"], ["ones"], [to: 1]},
        {"Mul", ["ones", "white"], ["bright"], []},
        {"Cast", ["bright"], ["mask"], [to: 2]},
        {"Mul", ["person", "white"], ["grey"], []},
        {"Cast", ["grey"], ["scores"], [to: 2]},
        {"ReduceMean", ["ones"], ["columns"], [axes: [0, 1, 3], keepdims: 0]},
        {"ReduceMean", ["ones"], ["rows"], [axes: [0, 2, 3], keepdims: 0]},
        {"Mul", ["person", "ones"], ["counted"], []},
        {"ReduceMean", ["counted"], ["sum"], [axes: [0, 1, 2], keepdims: 0]}
      ]
    )
  end

  defp segment_image(%{opts: opts} = state, %Image{width: w, height: h} = image) do
    {a, e} = {w / @side, h / @side}
    least = Tensor.from_list([opts[:min_score] / 1], :f32, {1})

    with {:ok, tensor} <- Patch.cut_whole(image, {@side, @side}, 1 / 255, 0.0),
         {:ok, %{"person" => person}} <- Model.run(state.model, %{"input" => tensor}),
         {:ok, read} <- Model.run(state.reader, %{"person" => person, "least" => least}) do
      {rects, masks} = extract_person(read, {a, e}, opts[:min_share])
      {:ok, %{rects: rects, masks: masks, scores: gray_image(@side, @side, read["scores"].data)}}
    end
  end

  defp extract_person(read, {a, e}, min_share) do
    columns = Tensor.to_list(read["columns"])
    share = Enum.sum(columns) / @side
    [sum] = Tensor.to_list(read["sum"])

    with true <- share > 0 and share >= min_share,
         {left, width} <- occupied_span(columns),
         {top, height} <- occupied_span(Tensor.to_list(read["rows"])) do
      rows =
        for y <- top..(top + height - 1),
            into: "",
            do: binary_part(read["mask"].data, y * @side + left, width)

      {[
         %Rect{
           x: left * a,
           y: top * e,
           width: width * a,
           height: height * e,
           label: "person",
           score: sum / share
         }
       ], [gray_image(width, height, rows)]}
    else
      _ -> {[], []}
    end
  end

  # Returns the span from the first to the last column or row that is more than a speck.
  defp occupied_span(parts) do
    case for {part, i} <- Enum.with_index(parts), part > @speck, do: i do
      [] -> nil
      [first | _] = positions -> {first, List.last(positions) - first + 1}
    end
  end

  defp gray_image(width, height, data),
    do: Image.new!(width: width, height: height, format: :gray8, data: data)
end
