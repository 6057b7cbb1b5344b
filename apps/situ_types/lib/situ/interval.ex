defmodule Situ.Interval do
  @moduledoc """
  An interval of numbers: time points, durations, indices or any other quantity.

  Each end is a point (`left`, `right`) with an inclusive flag, or `:unbounded`. Windows of `Situ.Reproducible`,
  `Situ.Available` and `Situ.window/3` are intervals of durations (ns) relative to a message's originating time:

      iex> window = Situ.Interval.past(Situ.Time.ms(20))
      iex> Situ.Interval.translate(window, Situ.Time.s(1))
      #Situ.Interval<[980000000,1000000000]>
      iex> Situ.Interval.contains?(window, -1)
      true

  An interval whose left end lies after its right end is *negative*; it holds the points between its ends like its
  mirror image does, and each flag stays with the point that it was given for.
  """

  alias Situ.Interval.{Overlap, Scale, Text}

  @enforce_keys [:left, :right]
  defstruct [:left, :right, left_inclusive: false, right_inclusive: false]

  @type point :: number()
  @type bound :: point() | :unbounded
  @type t :: %__MODULE__{
          left: bound(),
          right: bound(),
          left_inclusive: boolean(),
          right_inclusive: boolean()
        }

  @doc """
  An interval with these ends; an `:unbounded` end is never inclusive.

      iex> Situ.Interval.new(0, true, 10, false)
      #Situ.Interval<[0,10)>
  """
  @spec new(bound(), boolean(), bound(), boolean()) :: t()
  def new(left, left_inclusive, right, right_inclusive) do
    check_bound(left)
    check_bound(right)

    %__MODULE__{
      left: left,
      right: right,
      left_inclusive: left_inclusive and left != :unbounded,
      right_inclusive: right_inclusive and right != :unbounded
    }
  end

  @doc "`[left, right]`."
  @spec closed(bound(), bound()) :: t()
  def closed(left, right), do: new(left, true, right, true)

  @doc "`(left, right)`."
  @spec open(bound(), bound()) :: t()
  def open(left, right), do: new(left, false, right, false)

  @doc "From `left` on."
  @spec left_bounded(point(), boolean()) :: t()
  def left_bounded(left, inclusive \\ true), do: new(left, inclusive, :unbounded, false)

  @doc "Up to `right`."
  @spec right_bounded(point(), boolean()) :: t()
  def right_bounded(right, inclusive \\ true), do: new(:unbounded, false, right, inclusive)

  @doc "Everything."
  @spec infinite() :: t()
  def infinite, do: new(:unbounded, false, :unbounded, false)

  @doc "Nothing: `(0, 0)`."
  @spec empty() :: t()
  def empty, do: open(0, 0)

  @doc "`[0, 0]`: the same instant."
  @spec zero() :: t()
  def zero, do: closed(0, 0)

  @doc "`(-inf, 0]`: everything up to now."
  @spec past() :: t()
  def past, do: right_bounded(0)

  @doc "`[-span, 0]`, or `(-span, 0]` when not `inclusive`."
  @spec past(point(), boolean()) :: t()
  def past(span, inclusive \\ true), do: new(-span, inclusive, 0, true)

  @doc "`[0, inf)`: everything from now on."
  @spec future() :: t()
  def future, do: left_bounded(0)

  @doc "`[0, span]`, or `[0, span)` when not `inclusive`."
  @spec future(point(), boolean()) :: t()
  def future(span, inclusive \\ true), do: new(0, true, span, inclusive)

  @doc """
  `[-tolerance, tolerance]`. A negative tolerance is an `ArgumentError`.

      iex> Situ.Interval.within(5)
      #Situ.Interval<[-5,5]>
  """
  @spec within(point()) :: t()
  def within(tolerance) when is_number(tolerance) and tolerance >= 0,
    do: closed(-tolerance, tolerance)

  def within(tolerance) do
    raise ArgumentError,
          "a tolerance is a duration of 0 ns or more, got: #{inspect(tolerance)}"
  end

  @doc """
  Reads the notation that `to_string/1` writes.

      iex> Situ.Interval.parse("[-5,inf)")
      {:ok, Situ.Interval.left_bounded(-5)}
      iex> {:error, error} = Situ.Interval.parse("5 to 7")
      iex> error.code
      :bad_interval
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def parse(text) when is_binary(text) do
    with {:ok, ends} <- Text.parse(text), do: {:ok, from_ends(ends)}
  end

  @doc "Right minus left: negative for a negative interval, `:infinity` when an end is unbounded."
  @spec span(t()) :: point() | :infinity
  def span(%{left: left, right: right}) when is_number(left) and is_number(right),
    do: right - left

  def span(%__MODULE__{}), do: :infinity

  @doc "Whether the left end lies after the right end."
  @spec negative?(t()) :: boolean()
  def negative?(%{left: left, right: right}),
    do: is_number(left) and is_number(right) and left > right

  @doc "Whether both ends are bounded."
  @spec finite?(t()) :: boolean()
  def finite?(%{left: left, right: right}), do: is_number(left) and is_number(right)

  @doc "Whether at least one end is unbounded."
  @spec half_bounded?(t()) :: boolean()
  def half_bounded?(interval), do: not finite?(interval)

  @doc "Whether both ends are inclusive."
  @spec closed?(t()) :: boolean()
  def closed?(interval), do: interval.left_inclusive and interval.right_inclusive

  @doc "Whether neither end is inclusive (so `infinite/0` is open)."
  @spec open?(t()) :: boolean()
  def open?(interval), do: not interval.left_inclusive and not interval.right_inclusive

  @doc "Whether both ends are the same point."
  @spec degenerate?(t()) :: boolean()
  def degenerate?(interval), do: finite?(interval) and interval.left == interval.right

  @doc "Whether it holds no point: degenerate and not closed."
  @spec empty?(t()) :: boolean()
  def empty?(interval), do: degenerate?(interval) and not closed?(interval)

  @doc "The middle; `:infinity` when only bounded on the left, else `:neg_infinity` when unbounded."
  @spec center(t()) :: point() | :infinity | :neg_infinity
  def center(%{left: left, right: right}) when is_integer(left) and is_integer(right),
    do: left + div(right - left, 2)

  def center(%{left: left, right: right}) when is_number(left) and is_number(right),
    do: left + (right - left) / 2

  def center(%{left: left}) when is_number(left), do: :infinity
  def center(%__MODULE__{}), do: :neg_infinity

  @doc """
  Whether `point` lies inside.

      iex> Situ.Interval.contains?(Situ.Interval.new(42, true, 7, false), 42)
      true
  """
  @spec contains?(t(), point()) :: boolean()
  def contains?(interval, point) do
    %{left: left, right: right} = ordered = ordered(interval)

    after_left?(point, left, ordered.left_inclusive) and
      before_right?(point, right, ordered.right_inclusive)
  end

  @doc false
  # Whether `point` is not to the left of an interval that begins at `left`.
  @spec after_left?(point(), bound(), boolean()) :: boolean()
  def after_left?(_point, :unbounded, _inclusive), do: true
  def after_left?(point, left, true), do: point >= left
  def after_left?(point, left, false), do: point > left

  @doc false
  # Whether `point` is not to the right of an interval that ends at `right`.
  @spec before_right?(point(), bound(), boolean()) :: boolean()
  def before_right?(_point, :unbounded, _inclusive), do: true
  def before_right?(point, right, true), do: point <= right
  def before_right?(point, right, false), do: point < right

  @doc "Whether some point lies in both; touching ends count when both are inclusive."
  @spec intersects?(t(), t()) :: boolean()
  def intersects?(a, b), do: intersection(a, b) != nil

  @doc "Whether no point lies in both."
  @spec disjoint?(t(), t()) :: boolean()
  def disjoint?(a, b), do: not intersects?(a, b)

  @doc "The points in both, or `nil` when there are none."
  @spec intersection(t(), t()) :: t() | nil
  def intersection(a, b) do
    ends = if empty?(a) or empty?(b), do: nil, else: Overlap.common(ordered(a), ordered(b))
    ends && from_ends(ends)
  end

  @doc "Whether every point of `a` lies in `b`."
  @spec subset?(t(), t()) :: boolean()
  def subset?(a, b), do: empty?(a) or Overlap.within?(ordered(a), ordered(b))

  @doc "Whether `a` is a subset of `b`, and not the other way round."
  @spec proper_subset?(t(), t()) :: boolean()
  def proper_subset?(a, b), do: subset?(a, b) and not subset?(b, a)

  @doc """
  Moves both ends by `by`; unbounded ends stay. Also makes a relative interval absolute: `translate(window, time)`.
  """
  @spec translate(t(), point()) :: t()
  def translate(%__MODULE__{left: left, right: right} = interval, by) do
    %{interval | left: Scale.move(left, by), right: Scale.move(right, by)}
  end

  @doc "`scale_left/2` and `scale_right/2` at once, both from the span before."
  @spec scale(t(), amount, amount) :: t() when amount: {:by, point()} | {:factor, number()}
  def scale(interval, left, right), do: Scale.both(interval, span(interval), left, right)

  @doc """
  Moves the left end outwards, `{:by, span}` or so that the span is multiplied by `{:factor, f}`.

      iex> Situ.Interval.scale_left(Situ.Interval.closed(7, 42), {:factor, 2})
      #Situ.Interval<[-28,42]>
  """
  @spec scale_left(t(), {:by, point()} | {:factor, number()}) :: t()
  def scale_left(interval, amount), do: scale(interval, amount, {:by, 0})

  @doc "Moves the right end outwards, as `scale_left/2`."
  @spec scale_right(t(), {:by, point()} | {:factor, number()}) :: t()
  def scale_right(interval, amount), do: scale(interval, {:by, 0}, amount)

  @doc "Moves both ends outwards by half the amount each; halves of whole numbers are rounded outwards."
  @spec scale_center(t(), {:by, point()} | {:factor, number()}) :: t()
  def scale_center(interval, amount), do: Scale.center(interval, span(interval), amount)

  @doc """
  The smallest interval that holds all of these; empty ones are left out.

      iex> Situ.Interval.coverage([Situ.Interval.closed(7, 42), Situ.Interval.closed(200, 100)])
      #Situ.Interval<[7,200]>
  """
  @spec coverage([t()]) :: t()
  def coverage(intervals) do
    case intervals |> Enum.reject(&empty?/1) |> Enum.map(&ordered/1) do
      [] -> empty()
      [first | rest] -> Enum.reduce(rest, first, &from_ends(Overlap.cover(&1, &2)))
    end
  end

  @doc "The same points with the smaller end on the left."
  @spec ordered(t()) :: t()
  def ordered(%__MODULE__{} = interval) do
    if negative?(interval) do
      new(interval.right, interval.right_inclusive, interval.left, interval.left_inclusive)
    else
      interval
    end
  end

  @doc """
  In the usual notation.

      iex> Situ.Interval.to_string(Situ.Interval.past())
      "(-inf,0]"
  """
  @spec to_string(t()) :: String.t()
  def to_string(%__MODULE__{} = interval), do: Text.format(interval)

  defp from_ends({left, left_inclusive, right, right_inclusive}),
    do: new(left, left_inclusive, right, right_inclusive)

  defp check_bound(bound) when is_number(bound) or bound == :unbounded, do: :ok

  defp check_bound(bound) do
    raise ArgumentError, "an end is a number or :unbounded, got: #{inspect(bound)}"
  end

  defimpl Inspect do
    def inspect(interval, _opts),
      do: "#Situ.Interval<" <> Situ.Interval.to_string(interval) <> ">"
  end

  defimpl String.Chars do
    def to_string(interval), do: Situ.Interval.to_string(interval)
  end
end
