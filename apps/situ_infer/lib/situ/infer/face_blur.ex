defmodule Situ.Infer.FaceBlur do
  @schema [
    hold: [
      type: :time_ns,
      default: 500_000_000,
      doc:
        "How long a face is hidden before it is found and after it was last found, ns: detectors miss some."
    ],
    margin: [
      type: {:range, 1.0, 4.0},
      default: 1.5,
      doc: "How much larger than the face the part is that is hidden."
    ]
  ]

  @moduledoc """
  Pictures with their faces hidden: each is replaced by a few blurred spots, out of which nobody can make it again.

  The input is a pair of the picture and its faces, and the pictures come `:hold` later, for a face that is found in
  one picture is hidden in those before it too. A face that no picture within `:hold` shows to the detector stays as it
  is: look at the result before you hand it on.

      pictures |> Situ.join(Situ.via(pictures, Situ.Infer.FaceDetector)) |> Situ.via(Situ.Infer.FaceBlur)

  Pure, for use without a pipeline:

      iex> image = Situ.Image.filled(64, 64, :gray8, 200)
      iex> hidden = Situ.Infer.FaceBlur.hide(image, [Situ.Rect.new!(-4, 10, 20, 20)])
      iex> {hidden.width, hidden.height}
      {64, 64}

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [in: {:tuple, [Situ.Image, {:list, Situ.Infer.Face}]}],
    outputs: [out: Situ.Image],
    options: @schema

  alias Situ.{Image, Imaging, Rect}

  # A blurred face has so many spots across.
  @spots 4

  defstruct [:hold, :margin, waiting: :queue.new(), faces: []]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{hold: opts[:hold], margin: opts[:margin]}}

  @impl true
  def handle_message(:in, %{data: {image, faces}, originating_time: time}, _context, state) do
    rects = Enum.map(faces, &Rect.check!(&1.rect))
    found = for rect <- rects, do: {time, Rect.scale_around(rect, state.margin)}
    waiting = :queue.in({time, image}, state.waiting)
    decided(%{state | waiting: waiting, faces: state.faces ++ found}, time - state.hold, [])
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: decided(state, :unbounded, [])

  # Pictures whose neighbours are all known.
  defp decided(state, until, actions) do
    case :queue.peek(state.waiting) do
      {:value, {time, image}} when until == :unbounded or time <= until ->
        faces = Enum.drop_while(state.faces, fn {seen, _} -> seen < time - state.hold end)
        near = for {seen, rect} <- faces, seen <= time + state.hold, do: rect
        state = %{state | waiting: :queue.drop(state.waiting), faces: faces}
        decided(state, until, [{:out, time, hide(image, near)} | actions])

      _ ->
        {Enum.reverse(actions), state}
    end
  end

  @doc "The picture with these parts of it hidden; what lies outside of it does not count."
  @spec hide(Image.t(), [Rect.t()]) :: Image.t()
  def hide(image, rects),
    do: rects |> Enum.reduce([], &together/2) |> Enum.reduce(image, &spotted/2)

  # A face of neighbouring pictures lies in about the same place: one part that holds all of them.
  defp together(rect, others) do
    case Enum.split_with(others, &(Rect.iou(&1, rect) > 0.3)) do
      {[], others} -> [rect | others]
      {near, others} -> together(Enum.reduce(near, rect, &around/2), others)
    end
  end

  defp around(a, b) do
    {left, top} = {min(a.x, b.x), min(a.y, b.y)}
    right = max(a.x + a.width, b.x + b.width)
    bottom = max(a.y + a.height, b.y + b.height)
    Rect.new!(left, top, right - left, bottom - top)
  end

  defp spotted(rect, image) do
    left = rect.x |> floor() |> max(0)
    top = rect.y |> floor() |> max(0)
    width = min(ceil(rect.x + rect.width), image.width) - left
    height = min(ceil(rect.y + rect.height), image.height) - top

    if width > 0 and height > 0 do
      part = Imaging.crop!(image, {left, top, width, height})
      # Their number is the same whatever the size: more of a large face would say more.
      spots = Imaging.resize!(part, min(@spots, width), min(@spots, height), filter: :area)
      Imaging.paste!(image, Imaging.resize!(spots, width, height), {left, top})
    else
      image
    end
  end
end
