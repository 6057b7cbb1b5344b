defmodule Situ.Infer.FaceBlur do
  @moduledoc """
  Hides the faces in images. Each face is replaced by a few blurred spots from which it cannot be reconstructed.

  The input is a pair of an image and its faces. Images are emitted `:hold` later, because a face found in one image is
  also hidden in the images before it. A face that is not detected in any image within `:hold` is not hidden, so check
  the result before you share it.

      pictures |> Situ.join(Situ.via(pictures, Situ.Infer.FaceDetector)) |> Situ.via(Situ.Infer.FaceBlur)

  The pure functions also work without a pipeline:

      iex> image = Situ.Image.new_filled(64, 64, :gray8, 200)
      iex> hidden = Situ.Infer.FaceBlur.hide_rects(image, [Situ.Rect.new!(-4, 10, 20, 20)])
      iex> {hidden.width, hidden.height}
      {64, 64}
  """

  @schema [
    hold: [
      type: :time_ns,
      default: 500_000_000,
      doc:
        "How long before its first and after its last detection a face is hidden, in ns, since detectors miss some."
    ],
    margin: [
      type: {:range, 1.0, 4.0},
      default: 1.5,
      doc: "The size of the hidden area, relative to the face."
    ]
  ]

  use Situ.Component,
    inputs: [in: {:tuple, [Situ.Image, {:list, Situ.Infer.Face}]}],
    outputs: [out: Situ.Image],
    options: @schema

  alias Situ.{Image, ImageOps, Rect}

  # The number of spots across a blurred face.
  @spots 4

  defstruct [:hold, :margin, waiting: :queue.new(), faces: []]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{hold: opts[:hold], margin: opts[:margin]}}

  @impl true
  def handle_message(:in, %{data: {image, faces}, originating_time: time}, _context, state) do
    rects = Enum.map(faces, &Rect.validate!(&1.rect))
    found = for rect <- rects, do: {time, Rect.scale_around(rect, state.margin)}
    waiting = :queue.in({time, image}, state.waiting)
    emit_decided(%{state | waiting: waiting, faces: state.faces ++ found}, time - state.hold, [])
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: emit_decided(state, :unbounded, [])

  # Emits the images whose neighbours are all known.
  defp emit_decided(state, until, actions) do
    case :queue.peek(state.waiting) do
      {:value, {time, image}} when until == :unbounded or time <= until ->
        faces = Enum.drop_while(state.faces, fn {seen, _} -> seen < time - state.hold end)
        near = for {seen, rect} <- faces, seen <= time + state.hold, do: rect
        state = %{state | waiting: :queue.drop(state.waiting), faces: faces}
        emit_decided(state, until, [{:out, time, hide_rects(image, near)} | actions])

      _ ->
        {Enum.reverse(actions), state}
    end
  end

  @doc "Returns the image with these rectangles hidden; parts outside the image are ignored."
  @spec hide_rects(Image.t(), [Rect.t()]) :: Image.t()
  def hide_rects(image, rects),
    do: rects |> Enum.reduce([], &merge_rect/2) |> Enum.reduce(image, &blur_rect/2)

  # A face has about the same position in neighbouring images, so its rectangles are merged into their bounding box.
  defp merge_rect(rect, others) do
    case Enum.split_with(others, &(Rect.iou(&1, rect) > 0.3)) do
      {[], others} -> [rect | others]
      {near, others} -> merge_rect(Enum.reduce(near, rect, &bounding_rect/2), others)
    end
  end

  defp bounding_rect(a, b) do
    {left, top} = {min(a.x, b.x), min(a.y, b.y)}
    right = max(a.x + a.width, b.x + b.width)
    bottom = max(a.y + a.height, b.y + b.height)
    Rect.new!(left, top, right - left, bottom - top)
  end

  defp blur_rect(rect, image) do
    left = rect.x |> floor() |> max(0)
    top = rect.y |> floor() |> max(0)
    width = min(ceil(rect.x + rect.width), image.width) - left
    height = min(ceil(rect.y + rect.height), image.height) - top

    if width > 0 and height > 0 do
      part = ImageOps.crop!(image, {left, top, width, height})

      # The number of spots does not depend on the size, because more spots would reveal more of a large face.
      spots = ImageOps.resize!(part, min(@spots, width), min(@spots, height), filter: :area)
      ImageOps.paste!(image, ImageOps.resize!(spots, width, height), {left, top})
    else
      image
    end
  end
end
