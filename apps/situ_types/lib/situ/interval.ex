defmodule Situ.Interval do
  @moduledoc """
  An interval of numbers: time points, durations, indices or any other quantity.

  Each end is a point (`left`, `right`) with an inclusive flag, or `:unbounded`. The windows of `Situ.Reproducible`,
  `Situ.Available` and `Situ.window/3` are intervals of durations (ns) relative to a message's originating time:

      iex> window = Situ.Interval.past(Situ.Time.ms(20))
      iex> Situ.Interval.translate(window, Situ.Time.s(1))
      #Situ.Interval<[980000000,1000000000]>
      iex> Situ.Interval.contains_point?(window, -1)
      true

  An interval whose left end is greater than its right end is *negative*. It contains the same points as its mirror
  image, and each inclusive flag stays with its point.
  """

  alias Situ.Interval.{Overlap, Scaling, Notation}

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
  Builds an interval. An `:unbounded` end is never inclusive.

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

  @doc "Builds the closed interval `[left, right]`."
  @spec closed(bound(), bound()) :: t()
  def closed(left, right), do: new(left, true, right, true)

  @doc "Builds the open interval `(left, right)`."
  @spec open(bound(), bound()) :: t()
  def open(left, right), do: new(left, false, right, false)

  @doc "Builds an interval that starts at `left` and has no right bound."
  @spec left_bounded(point(), boolean()) :: t()
  def left_bounded(left, inclusive \\ true), do: new(left, inclusive, :unbounded, false)

  @doc "Builds an interval that ends at `right` and has no left bound."
  @spec right_bounded(point(), boolean()) :: t()
  def right_bounded(right, inclusive \\ true), do: new(:unbounded, false, right, inclusive)

  @doc "Builds the interval of all points."
  @spec infinite() :: t()
  def infinite, do: new(:unbounded, false, :unbounded, false)

  @doc "Builds the empty interval `(0, 0)`."
  @spec empty() :: t()
  def empty, do: open(0, 0)

  @doc "Builds `[0, 0]`, which as a window contains only the same instant."
  @spec zero() :: t()
  def zero, do: closed(0, 0)

  @doc "Builds `(-inf, 0]`, a window of everything up to now."
  @spec past() :: t()
  def past, do: right_bounded(0)

  @doc "Builds `[-span, 0]`, or `(-span, 0]` if not `inclusive`."
  @spec past(point(), boolean()) :: t()
  def past(span, inclusive \\ true), do: new(-span, inclusive, 0, true)

  @doc "Builds `[0, inf)`, a window of everything from now on."
  @spec future() :: t()
  def future, do: left_bounded(0)

  @doc "Builds `[0, span]`, or `[0, span)` if not `inclusive`."
  @spec future(point(), boolean()) :: t()
  def future(span, inclusive \\ true), do: new(0, true, span, inclusive)

  @doc """
  Builds `[-tolerance, tolerance]`; raises `ArgumentError` if the tolerance is negative.

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
  Parses the notation that `to_string/1` produces.

      iex> Situ.Interval.parse("[-5,inf)")
      {:ok, Situ.Interval.left_bounded(-5)}
      iex> {:error, error} = Situ.Interval.parse("5 to 7")
      iex> error.code
      :bad_interval
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def parse(text) when is_binary(text) do
    with {:ok, ends} <- Notation.parse_notation(text), do: {:ok, from_ends(ends)}
  end

  @doc "Returns right minus left: negative for a negative interval, `:infinity` if an end is unbounded."
  @spec span(t()) :: point() | :infinity
  def span(%{left: left, right: right}) when is_number(left) and is_number(right),
    do: right - left

  def span(%__MODULE__{}), do: :infinity

  @doc "Returns whether the left end is greater than the right end."
  @spec negative?(t()) :: boolean()
  def negative?(%{left: left, right: right}),
    do: is_number(left) and is_number(right) and left > right

  @doc "Returns whether both ends are bounded."
  @spec finite?(t()) :: boolean()
  def finite?(%{left: left, right: right}), do: is_number(left) and is_number(right)

  @doc "Returns whether at least one end is unbounded."
  @spec half_bounded?(t()) :: boolean()
  def half_bounded?(interval), do: not finite?(interval)

  @doc "Returns whether both ends are inclusive."
  @spec closed?(t()) :: boolean()
  def closed?(interval), do: interval.left_inclusive and interval.right_inclusive

  @doc "Returns whether neither end is inclusive (so `infinite/0` is open)."
  @spec open?(t()) :: boolean()
  def open?(interval), do: not interval.left_inclusive and not interval.right_inclusive

  @doc "Returns whether both ends are the same point."
  @spec degenerate?(t()) :: boolean()
  def degenerate?(interval), do: finite?(interval) and interval.left == interval.right

  @doc "Returns whether the interval contains no point, that is, whether it is degenerate and not closed."
  @spec empty?(t()) :: boolean()
  def empty?(interval), do: degenerate?(interval) and not closed?(interval)

  @doc "Returns the midpoint; `:infinity` if only the left end is bounded, `:neg_infinity` if the left end is not."
  @spec center_point(t()) :: point() | :infinity | :neg_infinity
  def center_point(%{left: left, right: right}) when is_integer(left) and is_integer(right),
    do: left + div(right - left, 2)

  def center_point(%{left: left, right: right}) when is_number(left) and is_number(right),
    do: left + (right - left) / 2

  def center_point(%{left: left}) when is_number(left), do: :infinity
  def center_point(%__MODULE__{}), do: :neg_infinity

  @doc """
  Returns whether the interval contains `point`.

      iex> Situ.Interval.contains_point?(Situ.Interval.new(42, true, 7, false), 42)
      true
  """
  @spec contains_point?(t(), point()) :: boolean()
  def contains_point?(interval, point) do
    %{left: left, right: right} = ordered = sort_ends(interval)

    after_left?(point, left, ordered.left_inclusive) and
      before_right?(point, right, ordered.right_inclusive)
  end

  @doc false
  # Returns whether `point` is not to the left of an interval that begins at `left`.
  @spec after_left?(point(), bound(), boolean()) :: boolean()
  def after_left?(_point, :unbounded, _inclusive), do: true
  def after_left?(point, left, true), do: point >= left
  def after_left?(point, left, false), do: point > left

  @doc false
  # Returns whether `point` is not to the right of an interval that ends at `right`.
  @spec before_right?(point(), bound(), boolean()) :: boolean()
  def before_right?(_point, :unbounded, _inclusive), do: true
  def before_right?(point, right, true), do: point <= right
  def before_right?(point, right, false), do: point < right

  @doc "Returns whether the intervals share a point; touching ends count if both are inclusive."
  @spec intersects?(t(), t()) :: boolean()
  def intersects?(a, b), do: intersection(a, b) != nil

  @doc "Returns whether the intervals share no point."
  @spec disjoint?(t(), t()) :: boolean()
  def disjoint?(a, b), do: not intersects?(a, b)

  @doc "Returns the interval of points in both, or `nil` if there are none."
  @spec intersection(t(), t()) :: t() | nil
  def intersection(a, b) do
    ends =
      if empty?(a) or empty?(b), do: nil, else: Overlap.common_ends(sort_ends(a), sort_ends(b))

    ends && from_ends(ends)
  end

  @doc "Returns whether `b` contains every point of `a`."
  @spec subset?(t(), t()) :: boolean()
  def subset?(a, b), do: empty?(a) or Overlap.fits_within?(sort_ends(a), sort_ends(b))

  @doc "Returns whether `a` is a subset of `b` and `b` is not a subset of `a`."
  @spec proper_subset?(t(), t()) :: boolean()
  def proper_subset?(a, b), do: subset?(a, b) and not subset?(b, a)

  @doc """
  Moves both ends by `by`; unbounded ends stay unbounded. To make a relative interval absolute, use
  `translate(window, time)`.
  """
  @spec translate(t(), point()) :: t()
  def translate(%__MODULE__{left: left, right: right} = interval, by) do
    %{interval | left: Scaling.move_bound(left, by), right: Scaling.move_bound(right, by)}
  end

  @doc "Moves both ends outwards like `scale_left/2` and `scale_right/2`, both based on the original span."
  @spec scale(t(), amount, amount) :: t() when amount: {:by, point()} | {:factor, number()}
  def scale(interval, left, right), do: Scaling.scale_ends(interval, span(interval), left, right)

  @doc """
  Moves the left end outwards by a span (`{:by, span}`), or so that the span is multiplied by `f` (`{:factor, f}`).

      iex> Situ.Interval.scale_left(Situ.Interval.closed(7, 42), {:factor, 2})
      #Situ.Interval<[-28,42]>
  """
  @spec scale_left(t(), {:by, point()} | {:factor, number()}) :: t()
  def scale_left(interval, amount), do: scale(interval, amount, {:by, 0})

  @doc "Moves the right end outwards, like `scale_left/2`."
  @spec scale_right(t(), {:by, point()} | {:factor, number()}) :: t()
  def scale_right(interval, amount), do: scale(interval, {:by, 0}, amount)

  @doc "Moves each end outwards by half the amount; halves of odd integers are rounded outwards."
  @spec scale_center(t(), {:by, point()} | {:factor, number()}) :: t()
  def scale_center(interval, amount),
    do: Scaling.scale_around_center(interval, span(interval), amount)

  @doc """
  Returns the smallest interval that contains all of the given intervals; empty ones are ignored.

      iex> Situ.Interval.coverage([Situ.Interval.closed(7, 42), Situ.Interval.closed(200, 100)])
      #Situ.Interval<[7,200]>
  """
  @spec coverage([t()]) :: t()
  def coverage(intervals) do
    case intervals |> Enum.reject(&empty?/1) |> Enum.map(&sort_ends/1) do
      [] -> empty()
      [first | rest] -> Enum.reduce(rest, first, &from_ends(Overlap.covering_ends(&1, &2)))
    end
  end

  @doc "Returns the interval with its smaller end on the left; it contains the same points."
  @spec sort_ends(t()) :: t()
  def sort_ends(%__MODULE__{} = interval) do
    if negative?(interval) do
      new(interval.right, interval.right_inclusive, interval.left, interval.left_inclusive)
    else
      interval
    end
  end

  @doc """
  Formats the interval in the usual notation.

      iex> Situ.Interval.to_string(Situ.Interval.past())
      "(-inf,0]"
  """
  @spec to_string(t()) :: String.t()
  def to_string(%__MODULE__{} = interval), do: Notation.format_notation(interval)

  defp from_ends({left, left_inclusive, right, right_inclusive}),
    do: new(left, left_inclusive, right, right_inclusive)

  defp check_bound(bound) when is_number(bound) or bound == :unbounded, do: :ok

  defp check_bound(bound) do
    raise ArgumentError, "an end must be a number or :unbounded, got: #{inspect(bound)}"
  end

  defimpl Inspect do
    def inspect(interval, _opts),
      do: "#Situ.Interval<" <> Situ.Interval.to_string(interval) <> ">"
  end

  defimpl String.Chars do
    def to_string(interval), do: Situ.Interval.to_string(interval)
  end
end
