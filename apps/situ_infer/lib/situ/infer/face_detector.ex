defmodule Situ.Infer.FaceDetector do
  @moduledoc """
  Finds faces in images (BlazeFace short range).

  Input `:in` is a `Situ.Image` of an 8-bit format. Output `:out` is a list of `Situ.Infer.Face` at the image's time,
  which may be empty. Faces of at least a quarter of the image are found in the whole image. Smaller faces,
  down to 40 pixels, are found in tiles within two seconds of their appearance, and then in close-ups. While no face
  moves, faces are searched for only every `:every` nanoseconds, and keep their positions in between.

      frames |> Situ.via(Situ.Infer.FaceDetector, min_score: 0.6)

  One detection takes about 1.2 ms on one core. An image needs one detection, one for each face that is not large, and
  one for each tile; while faces rest it needs a third of that. The first image is searched completely.
  """

  @schema Situ.Infer.BundledModel.schema() ++
            [
              min_score: [
                type: {:range, 0.01, 0.99},
                default: 0.5,
                doc: "The minimum score of a face."
              ],
              tile_score: [
                type: {:range, 0.01, 0.99},
                default: 0.7,
                doc:
                  "The minimum score of a face found in a tile; tiles contain more false faces."
              ],
              tiles: [
                type: {:optional, :non_neg_integer},
                default: nil,
                doc:
                  "The number of tiles searched for small faces per image, in rotation. `nil` uses the number that " <>
                    "covers everything in 50 images; 0 searches no tiles."
              ],
              every: [
                type: :time_ns,
                default: 120_000_000,
                doc: "How often faces at rest are searched for, in ns; 0 searches in every image."
              ]
            ]

  use Situ.Component,
    inputs: [in: Situ.Image],
    outputs: [out: {:list, Situ.Infer.Face}],
    options: @schema

  alias Situ.Infer.Face.{Blaze, Search}
  alias Situ.Infer.{BundledModel, Model, Patch, Suppression}

  # Maps 0..255 to the network's input range, -1..1.
  @scale 1 / 127.5
  @offset -1.0

  defstruct [:model, :opts, :search]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts, search: Search.new(opts)}}

  @impl true
  def handle_start(_context, state),
    do: {[], %{state | model: Situ.Error.unwrap!(load_model(state.opts))}}

  @impl true
  def handle_message(:in, message, _context, state) do
    %{data: image, originating_time: time} = message

    case search_faces(state.model, image, time, state.search) do
      {:ok, faces, search} -> {[{:out, time, faces}], %{state | search: search}}
      {:error, error} -> raise error
    end
  end

  @impl true
  def describe(%{model: nil}), do: "not started"

  def describe(%{model: model, search: search}),
    do: "#{length(search.faces)} faces; #{Model.describe_runs(model)}"

  @doc """
  Finds the faces in one image, without a pipeline: `detect(image)` searches everything once.

  See the options above. Returns the errors of `Situ.Infer.Model` and `:bad_image`.
  """
  @spec detect(Situ.Image.t(), keyword()) ::
          {:ok, [Situ.Infer.Face.t()]} | {:error, Situ.Error.t()}
  def detect(%Situ.Image{} = image, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, model} <- load_model(opts),
         {:ok, faces, _} <- search_faces(model, image, 0, Search.new(opts)),
         do: {:ok, faces}
  end

  defp load_model(opts),
    do: BundledModel.load(opts, "face_detection_short_range.onnx", Blaze.required_ports())

  defp search_faces(model, image, time, search) do
    Search.search_image(search, {image.width, image.height}, time, fn patch, min_score ->
      with {:ok, tensor} <- Patch.cut_tensor(patch, image, @scale, @offset),
           {:ok, outputs} <- Model.run(model, %{"input" => tensor}) do
        {:ok,
         outputs
         |> Blaze.decode_faces(patch, min_score)
         |> Suppression.suppress_faces(0.3)}
      end
    end)
  end
end
