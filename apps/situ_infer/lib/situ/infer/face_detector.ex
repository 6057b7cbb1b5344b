defmodule Situ.Infer.FaceDetector do
  @schema [
    model: [
      type: {:optional, :string},
      default: nil,
      doc: "The ONNX file; `nil` for the one that ships with the app."
    ],
    model_options: [type: :keyword, default: [], doc: "For `Situ.Infer.Model.shared/2`."],
    min_score: [type: {:range, 0.01, 0.99}, default: 0.5, doc: "How sure a face must be."],
    tile_score: [
      type: {:range, 0.01, 0.99},
      default: 0.7,
      doc: "The same for faces found in tiles, which see more that only looks like a face."
    ],
    tiles: [
      type: {:optional, :non_neg_integer},
      default: nil,
      doc:
        "Tiles searched in each picture for small faces, in turn; `nil`: so many that 50 " <>
          "pictures cover everything. 0 for none."
    ],
    every: [
      type: :time_ns,
      default: 120_000_000,
      doc: "How often faces that rest are looked for, ns; 0: in every picture."
    ]
  ]

  @moduledoc """
  Finds faces in pictures (BlazeFace short range).

  Input `:in` is a `Situ.Image` of an 8-bit format, output `:out` a list of `Situ.Infer.Face` at the picture's time.
  Faces of a quarter of the picture or more are seen in the whole picture; smaller ones, down to 40 pixels, are found
  in tiles within two seconds of their appearance, and then looked at closely. While no face moves, they are looked
  for every `:every` nanoseconds, and stay where they are between. No face is an empty list.

      frames |> Situ.via(Situ.Infer.FaceDetector, min_score: 0.6)

  One look costs about 1.2 ms on one core. A picture takes one look, one for each face that is not large, and one for
  each tile; where faces rest, a third of that; the first picture is searched in full.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [in: Situ.Image],
    outputs: [out: {:list, Situ.Infer.Face}],
    options: @schema

  alias Situ.Infer.Face.{Blaze, Search}
  alias Situ.Infer.{Model, Patch}

  # Network input: 0..255 becomes -1..1.
  @scale 1 / 127.5
  @offset -1.0

  defstruct [:model, :opts, :search]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts, search: Search.new(opts)}}

  @impl true
  def handle_start(_context, state), do: {[], %{state | model: load!(state.opts)}}

  @impl true
  def handle_message(:in, message, _context, state) do
    {faces, search} = detect!(state.model, message, state.search)
    {[{:out, message.originating_time, faces}], %{state | search: search}}
  end

  @impl true
  def describe(%{model: nil}), do: "not started"

  def describe(%{model: model, search: search}),
    do: "#{length(search.faces)} faces; #{Model.describe(model)}"

  @doc """
  The faces of one picture, without a pipeline: `detect(image)` looks everywhere once.

  Options as above. Errors: those of `Situ.Infer.Model`, `:bad_image`.
  """
  @spec detect(Situ.Image.t(), keyword()) ::
          {:ok, [Situ.Infer.Face.t()]} | {:error, Situ.Error.t()}
  def detect(%Situ.Image{} = image, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, model} <- load(opts),
         {:ok, faces, _} <- step(model, image, 0, Search.new(opts)),
         do: {:ok, faces}
  end

  defp load(opts) do
    path = opts[:model] || Model.path("face_detection_short_range.onnx")
    Model.shared(path, Keyword.merge(opts[:model_options], Blaze.ports()))
  end

  defp load!(opts), do: opts |> load() |> Situ.Error.unwrap!()

  defp detect!(model, message, search) do
    case step(model, message.data, message.originating_time, search) do
      {:ok, faces, search} -> {faces, search}
      {:error, error} -> raise error
    end
  end

  defp step(model, image, time, search) do
    Search.step(search, {image.width, image.height}, time, fn patch, min_score ->
      with {:ok, tensor} <- Patch.cut(patch, image, @scale, @offset),
           {:ok, outputs} <- Model.run(model, %{"input" => tensor}) do
        {:ok, outputs |> Blaze.decode(patch, min_score) |> Situ.Infer.Face.Overlap.suppress(0.3)}
      end
    end)
  end
end
