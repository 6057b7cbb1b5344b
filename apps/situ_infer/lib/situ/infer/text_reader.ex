defmodule Situ.Infer.TextReader do
  @moduledoc """
  Reads text in images: signs, labels, screens, pages; Latin letters, digits and Chinese.

      texts = Situ.via(pictures, Situ.Infer.TextReader)
      Situ.each(texts, fn lines -> for line <- lines, do: IO.puts(line.label) end)

  Input `:in` is images (`Situ.Image`, 8 bits). Output `:out` is a list for each image, at its time. It contains the
  lines from top to bottom as `Situ.Rect` (upright around the line, in image pixels), with the text as label and a
  score. The studio draws them over the image. Lines may be rotated, and may run downwards.

  The networks are PP-OCRv4's (Apache-2.0, `bin/lib/fetch-model pp-ocr-v4`). One finds lines, and the other reads each
  line. An image takes about half a second on one core, so use `Situ.Delivery.latest()` for a camera. `read_lines/2`
  reads a single image.

  ## Errors

  `:bad_image`, and the errors of `Situ.Infer.Model`.
  """

  @schema [
    folder: [
      type: {:optional, :string},
      default: nil,
      doc: "The folder with the two files of PP-OCRv4; `nil`: where `fetch-model` puts them."
    ],
    side: [
      type: {:range, 64, 4_096},
      default: 736,
      doc: "The minimum length of the shorter side, in pixels; smaller images are enlarged."
    ],
    longest: [
      type: {:range, 64, 4_096},
      default: 1_600,
      doc: "The maximum length of the longer side after that, in pixels; it overrides `side:`."
    ],
    min_score: [
      type: {:range, 0, 1},
      default: 0.5,
      doc: "Lines with a lower confidence are left out."
    ]
  ]

  use Situ.Component,
    inputs: [in: Situ.Image],
    outputs: [out: {:list, Situ.Rect}],
    options: @schema

  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{Error, Image, Rect, Tensor}
  alias Situ.Infer.{Model, ModelStore, Onnx, Patch}
  alias Situ.Infer.Vision.TextRegions

  @name "pp-ocr-v4"
  @finder "ch_PP-OCRv4_det_infer.onnx"
  @reader "ch_PP-OCRv4_rec_infer.onnx"
  # Both networks were trained on -1..1, blue first.
  @scale 2 / 255
  @offset -1.0
  @line 48
  @shortest_line 320
  @longest_line 3_200

  @enforce_keys [:finder, :reader, :glue, :characters, :opts]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          finder: Model.t(),
          reader: Model.t(),
          glue: Model.t(),
          characters: tuple(),
          opts: map()
        }

  @impl true
  def init(opts), do: {:ok, %{opts: opts, reader: nil}}

  @impl true
  def handle_start(_context, %{opts: opts} = state),
    do: {[], %{state | reader: Error.unwrap!(load_models(opts))}}

  @impl true
  def handle_message(:in, %{data: image, originating_time: time}, _context, state),
    do: {[{:out, time, Error.unwrap!(read_lines(state.reader, image))}], state}

  @doc "Loads the networks."
  @spec load_models(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load_models(opts \\ []) do
    settings = [warm_up: 0, schedule: :dirty, sessions: 1]
    picture = %{"x" => {:f32, {nil, 3, nil, nil}}}

    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, finder} <- ModelStore.locate_file(opts[:folder], @name, @finder),
         {:ok, reader} <- ModelStore.locate_file(opts[:folder], @name, @reader),
         {:ok, characters} <- load_characters(reader),
         {:ok, finder} <- Model.load_shared(finder, [{:inputs, picture} | settings]),
         {:ok, reader} <- Model.load_shared(reader, [{:inputs, picture} | settings]),
         {:ok, glue} <- Model.from_bytes(encode_glue(), "text input", settings) do
      {:ok,
       %__MODULE__{
         finder: finder,
         reader: reader,
         glue: glue,
         characters: characters,
         opts: Map.new(opts)
       }}
    end
  end

  # Character 0 is the blank; the last character, which the file does not list, is a space.
  defp load_characters(path) do
    with {:ok, bytes} <- File.read(path),
         %{"character" => characters} <- Onnx.parse_metadata(bytes) do
      {:ok, List.to_tuple([""] ++ String.split(characters, ["\r\n", "\n"]) ++ [" "])}
    else
      {:error, _} ->
        {:error, Error.new(:no_model_file, "file #{path} does not exist", fix: fetch_hint())}

      _ ->
        {:error,
         Error.new(:bad_model, "the model #{path} does not list its characters", fix: fetch_hint())}
    end
  end

  defp fetch_hint, do: "run bin/lib/fetch-model #{@name}"

  # Converts to BGR planes, and pads short lines with grey on the right.
  defp encode_glue do
    Onnx.encode(
      inputs: [{"picture", :f32, {1, nil, nil, 3}}, {"pads", :s64, {8}}],
      outputs: [{"x", :f32, {1, 3, nil, nil}}],
      constants: %{"order" => Tensor.from_list([2, 1, 0], :s64, {3})},
      nodes: [
        {"Gather", ["picture", "order"], ["ordered"], [axis: 3]},
        {"Transpose", ["ordered"], ["planes"], [perm: [0, 3, 1, 2]]},
        {"Pad", ["planes", "pads"], ["x"], []}
      ]
    )
  end

  @doc "Reads the lines of text in an image, from top to bottom."
  @spec read_lines(t(), Image.t()) :: {:ok, [Rect.t()]} | {:error, Error.t()}
  def read_lines(%__MODULE__{} = reader, %Image{width: w, height: h} = image) do
    # An image without pixels has no scale; sampling it returns the error.
    {width, height} = input_size(max(w, 1), max(h, 1), reader.opts)
    {kx, ky} = {w / width, h / height}

    with {:ok, pixels} <- Patch.cut_whole(image, {width, height}, @scale, @offset),
         {:ok, map} <- run_network(reader, reader.finder, pixels, 0),
         regions = map |> TextRegions.find_regions() |> Enum.map(&scale_line(&1, kx, ky)),
         {:ok, lines} <- Error.map_ok(regions, &read_line(&1, reader, image)) do
      rects =
        for {region, {text, score}} <- Enum.zip(regions, lines),
            text != "" and score >= reader.opts.min_score,
            do: upright_rect(region, text, score)

      {:ok, Enum.sort_by(rects, &{round(&1.y / 10), &1.x})}
    end
  end

  # The network halves the image five times, so the sides must be multiples of 32.
  defp input_size(w, h, opts) do
    ratio = max(opts.side / min(w, h), 1.0)
    ratio = min(ratio, opts.longest / max(w, h))
    {round_to_32(w * ratio), round_to_32(h * ratio)}
  end

  defp round_to_32(x), do: max(round(x / 32) * 32, 32)

  defp run_network(reader, model, pixels, pad) do
    pads = Tensor.from_list([0, 0, 0, 0, 0, 0, 0, pad], :s64, {8})

    with {:ok, %{"x" => x}} <- Model.run(reader.glue, %{"picture" => pixels, "pads" => pads}),
         {:ok, outputs} <- Model.run(model, %{"x" => x}) do
      [{_, tensor}] = Enum.to_list(outputs)
      {:ok, tensor}
    end
  end

  # Converts from map pixels to image pixels; the horizontal and vertical scales differ slightly.
  defp scale_line(%{center: {x, y}, right: {ux, uy}, width: w, height: h} = region, kx, ky) do
    {rx, ry} = {ux * kx, uy * ky}
    along = :math.sqrt(rx * rx + ry * ry)
    {dx, dy} = {-uy * kx, ux * ky}
    across = :math.sqrt(dx * dx + dy * dy)

    %{
      region
      | center: {(x + 0.5) * kx - 0.5, (y + 0.5) * ky - 0.5},
        right: {rx / along, ry / along},
        width: w * along,
        height: h * across
    }
  end

  defp read_line(%{center: {cx, cy}, right: {ux, uy}} = region, reader, image) do
    k = region.height / @line
    width = (region.width / k) |> ceil() |> max(@line) |> min(@longest_line)
    kx = region.width / width
    {a, d, b, e} = {ux * kx, uy * kx, -uy * k, ux * k}
    {mx, my} = {(width - 1) / 2, (@line - 1) / 2}
    matrix = {a, b, cx - a * mx - b * my, d, e, cy - d * mx - e * my}

    with {:ok, pixels} <- Patch.cut_affine(image, matrix, {width, @line}, @scale, @offset),
         {:ok, chances} <-
           run_network(reader, reader.reader, pixels, max(@shortest_line - width, 0)),
         do: {:ok, decode_text(chances, reader.characters)}
  end

  # Takes the most likely character of each step, merges repeated characters, and drops character 0 (CTC decoding).
  defp decode_text(%Tensor{shape: {1, _, characters}, data: data}, names) do
    steps =
      for <<step::binary-pinned_size(characters * 4) <- data>>,
        do: likeliest_character(step, 0, {0, 0.0})

    letters = steps |> Enum.dedup_by(&elem(&1, 0)) |> Enum.reject(&(elem(&1, 0) == 0))
    text = for {i, _} <- letters, i < tuple_size(names), into: "", do: elem(names, i)

    score =
      if letters == [],
        do: 0.0,
        else: Enum.sum(Enum.map(letters, &elem(&1, 1))) / length(letters)

    {String.trim(text), score}
  end

  defp likeliest_character(<<p::float-native-32, rest::binary>>, i, {_, most}) when p > most,
    do: likeliest_character(rest, i + 1, {i, p})

  defp likeliest_character(<<_::32, rest::binary>>, i, best),
    do: likeliest_character(rest, i + 1, best)

  defp likeliest_character(<<>>, _i, best), do: best

  defp upright_rect(%{center: {cx, cy}, right: {ux, uy}, width: w, height: h}, text, score) do
    {w, h} = {abs(ux) * w + abs(uy) * h, abs(uy) * w + abs(ux) * h}

    Rect.new!(
      x: cx - w / 2,
      y: cy - h / 2,
      width: w,
      height: h,
      label: text,
      score: min(score, 1.0)
    )
  end
end
