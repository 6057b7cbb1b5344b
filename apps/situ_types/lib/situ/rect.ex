defmodule Situ.Rect do
  @moduledoc """
  An axis-aligned rectangle in an image, in pixels from the top left corner. Detectors return rectangles and the
  studio draws them.

  `x` and `y` are the left and top edges. Numbers may be fractions and may be outside the image. `label`, `score`
  (0..1) and `id` (of a track) are optional.

      iex> face = Situ.Rect.new!(x: 10, y: 20, width: 30, height: 40, label: "face", score: 0.9)
      iex> {Situ.Rect.center_point(face), Situ.Rect.area(face)}
      {%Situ.Point2{x: 25.0, y: 40.0}, 1200}
  """
  alias Situ.{Error, Point2}

  @enforce_keys [:x, :y, :width, :height]
  defstruct [:x, :y, :width, :height, label: nil, score: nil, id: nil]

  @type t :: %__MODULE__{
          x: number(),
          y: number(),
          width: number(),
          height: number(),
          label: String.t() | nil,
          score: number() | nil,
          id: term()
        }

  # The limit is in pixels. Products of numbers within it are exact enough and do not overflow.
  @most 1_000_000_000

  @schema [
    x: [type: :number, required: true, doc: "Left edge."],
    y: [type: :number, required: true, doc: "Top edge."],
    width: [type: :number, required: true, doc: "Width, 0 or more."],
    height: [type: :number, required: true, doc: "Height, 0 or more."],
    label: [type: {:optional, :string}, default: nil, doc: "The name of the object inside."],
    score: [type: {:optional, :number}, default: nil, doc: "Confidence, 0..1."],
    id: [type: :any, default: nil, doc: "The identity of the object over time."]
  ]

  @doc """
  Builds a validated rectangle.

  #{Situ.Options.docs(@schema)}

      iex> {:error, error} = Situ.Rect.new(x: 0, y: 0, width: -1, height: 2)
      iex> error.code
      :bad_rect
  """
  @spec new(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      if opts[:width] < 0 or opts[:height] < 0 do
        what = "invalid rectangle size #{opts[:width]} x #{opts[:height]}: it is negative"
        {:error, Error.new(:bad_rect, what)}
      else
        {:ok, struct!(__MODULE__, opts)}
      end
    end
  end

  @doc "Like `new/1`, but returns the rectangle or raises the error."
  @spec new!(keyword()) :: t()
  def new!(opts), do: Situ.Error.unwrap!(new(opts))

  @doc "Builds a rectangle from its left edge, top edge, width and height, without a label."
  @spec new!(number(), number(), number(), number()) :: t()
  def new!(x, y, width, height), do: new!(x: x, y: y, width: width, height: height)

  @doc """
  Validates a rectangle from an untrusted source: coordinates must be numbers within #{@most} pixels of the corner,
  and sizes must not be negative. Error: `:bad_rect`, whose `why` names the invalid field.

      iex> Situ.Rect.validate(Situ.Rect.new!(0, 0, 2, 2))
      {:ok, Situ.Rect.new!(0, 0, 2, 2)}
      iex> {:error, error} = Situ.Rect.validate(%Situ.Rect{x: 0, y: :nan, width: 2, height: 2})
      iex> error.why
      "y is :nan"
  """
  @spec validate(term()) :: {:ok, t()} | {:error, Error.t()}
  def validate(%__MODULE__{x: x, y: y, width: w, height: h} = rect)
      when is_number(x) and is_number(y) and is_number(w) and is_number(h) and
             abs(x) <= @most and abs(y) <= @most and w >= 0 and w <= @most and h >= 0 and
             h <= @most,
      do: {:ok, rect}

  def validate(other) do
    why =
      case other do
        %__MODULE__{} ->
          "#{first_invalid_field(other)} is #{inspect(Map.get(other, first_invalid_field(other)), limit: 8)}"

        _ ->
          "it is #{inspect(other, limit: 8, printable_limit: 80)}"
      end

    {:error,
     Error.new(:bad_rect, "invalid rectangle",
       why: why,
       fix: "use Situ.Rect.new/1, with coordinates within #{@most} pixels of the corner"
     )}
  end

  defp first_invalid_field(rect) do
    Enum.find([:x, :y, :width, :height], fn name ->
      value = Map.get(rect, name)
      least = if name in [:width, :height], do: 0, else: -@most
      not (is_number(value) and value >= least and value <= @most)
    end)
  end

  @doc "Like `validate/1`, but returns the rectangle or raises the error."
  @spec validate!(term()) :: t()
  def validate!(rect), do: Error.unwrap!(validate(rect))

  @doc "Returns width times height."
  @spec area(t()) :: number()
  def area(%__MODULE__{} = r), do: r.width * r.height

  @doc "Returns the center."
  @spec center_point(t()) :: Point2.t()
  def center_point(%__MODULE__{} = r), do: %Point2{x: r.x + r.width / 2, y: r.y + r.height / 2}

  @doc """
  Returns the intersection, with the label, score and id of `a`, or `nil` if the rectangles do not overlap.

      iex> a = Situ.Rect.new!(0, 0, 4, 4)
      iex> Situ.Rect.intersect(a, Situ.Rect.new!(2, 3, 9, 9))
      %Situ.Rect{x: 2, y: 3, width: 2, height: 1}
      iex> Situ.Rect.intersect(a, Situ.Rect.new!(4, 0, 1, 1))
      nil
  """
  @spec intersect(t(), t()) :: t() | nil
  def intersect(%__MODULE__{} = a, %__MODULE__{} = b) do
    x = max(a.x, b.x)
    y = max(a.y, b.y)
    width = min(a.x + a.width, b.x + b.width) - x
    height = min(a.y + a.height, b.y + b.height) - y
    if width > 0 and height > 0, do: %{a | x: x, y: y, width: width, height: height}
  end

  @doc """
  Returns the intersection over union of two rectangles, 0.0..1.0.

      iex> Situ.Rect.iou(Situ.Rect.new!(0, 0, 2, 2), Situ.Rect.new!(1, 0, 2, 2))
      0.3333333333333333
  """
  @spec iou(t(), t()) :: float()
  def iou(%__MODULE__{} = a, %__MODULE__{} = b) do
    case intersect(a, b) do
      nil -> 0.0
      common -> area(common) / (area(a) + area(b) - area(common))
    end
  end

  @doc """
  Scales the rectangle around its center.

      iex> Situ.Rect.scale_around(Situ.Rect.new!(10, 10, 10, 20), 2)
      %Situ.Rect{x: 5.0, y: 0.0, width: 20, height: 40}
  """
  @spec scale_around(t(), number()) :: t()
  def scale_around(%__MODULE__{} = r, factor) do
    %{width: w, height: h} = r
    grown = %{r | width: w * factor, height: h * factor}
    %{grown | x: r.x - (grown.width - w) / 2, y: r.y - (grown.height - h) / 2}
  end

  @doc "Returns whether the point is inside. Left and top edges count as inside; right and bottom edges do not."
  @spec contains_point?(t(), Point2.t()) :: boolean()
  def contains_point?(%__MODULE__{} = r, %Point2{x: x, y: y}),
    do: x >= r.x and y >= r.y and x < r.x + r.width and y < r.y + r.height
end
