defmodule Situ.Reproducible do
  @moduledoc """
  Interpolators whose values do not depend on timing: they wait until no later message can change the result.

  A window is a `Situ.Interval` of ns relative to the requested time, or a tolerance: `5` means `[-5, 5]`. Every
  function takes `or_default: value`, the value to use where none exists.

  | interpolator | value | decided when the stream has |
  |---|---|---|
  | `exact/1` | the message at exactly that time | reached the time |
  | `nearest/2` | the nearest in the window (the later if equal) | reached the time, or the window's end if needed |
  | `first/2` | the first in the window | a message in the window or past it |
  | `last/2` | the last in the window | reached the window's end |
  | `linear/1` | the linear interpolation between the neighbours (numbers) | reached the time |
  | `adjacent/2` | a function of the neighbours | reached the time |

  The end of the stream decides everything. `last(Situ.Interval.past())` is the latest value so far, reproducibly.

      iex> messages = for {t, v} <- [{10, :a}, {20, :b}], do: %Situ.Message{originating_time: t, data: v}
      iex> Situ.Interpolator.interpolate(Situ.Reproducible.nearest(), 14, messages, nil)
      {:created, :a, 10}
      iex> Situ.Interpolator.interpolate(Situ.Reproducible.nearest(), 24, messages, nil)
      {:wait, 24}
  """

  alias Situ.{Interpolator, Interval}
  alias Situ.Interpolator.{Adjacent, First, Last, Nearest}

  @type window :: Interval.t() | Situ.Time.duration()

  @doc """
  Selects the message with exactly the requested time.

      iex> inputs = [image: [{10, :image}], gaze: [{7, 1}, {12, 3}]]
      iex> Situ.Test.run(inputs, &Situ.join(&1.image, &1.gaze, Situ.Reproducible.exact()))
      {:ok, []}
  """
  @spec exact(keyword()) :: Interpolator.t()
  def exact(opts \\ []), do: nearest(Interval.zero(), opts)

  @doc """
  Selects the nearest message in the window (default: any distance).

      iex> inputs = [image: [{10, :image}], gaze: [{7, 1}, {12, 3}]]
      iex> Situ.Test.run(inputs, &Situ.join(&1.image, &1.gaze, Situ.Reproducible.nearest(2)))
      {:ok, [{10, {:image, 3}}]}
  """
  @spec nearest(window() | keyword(), keyword()) :: Interpolator.t()
  def nearest(window \\ Interval.infinite(), opts \\ []) do
    {window, opts} = Interpolator.parse_window(window, opts, Interval.infinite())
    Interpolator.new(Nearest, {window, true}, [reproducible: true, gives: :messages] ++ opts)
  end

  @doc """
  Selects the first message in the window (default: at or after the requested time). The window's left end must be
  bounded.

      iex> inputs = [image: [{10, :image}], gaze: [{7, 1}, {12, 3}]]
      iex> Situ.Test.run(inputs, &Situ.join(&1.image, &1.gaze, Situ.Reproducible.first()))
      {:ok, [{10, {:image, 3}}]}
  """
  @spec first(window() | keyword(), keyword()) :: Interpolator.t()
  def first(window \\ Interval.future(), opts \\ []) do
    {window, opts} = Interpolator.parse_window(window, opts, Interval.future())
    left_bounded!(window)
    Interpolator.new(First, {window, true}, [reproducible: true, gives: :messages] ++ opts)
  end

  @doc """
  Selects the last message in the window (default: at or before the requested time).

      iex> inputs = [image: [{10, :image}], gaze: [{7, 1}, {12, 3}]]
      iex> Situ.Test.run(inputs, &Situ.join(&1.image, &1.gaze, Situ.Reproducible.last()))
      {:ok, [{10, {:image, 1}}]}
  """
  @spec last(window() | keyword(), keyword()) :: Interpolator.t()
  def last(window \\ Interval.past(), opts \\ []) do
    {window, opts} = Interpolator.parse_window(window, opts, Interval.past())
    Interpolator.new(Last, {window, true}, [reproducible: true, gives: :messages] ++ opts)
  end

  @doc """
  Interpolates linearly between the messages before and after. There is no value before the first message or after the
  last one.

      iex> inputs = [image: [{10, :image}], gaze: [{7, 1}, {12, 3}]]
      iex> Situ.Test.run(inputs, &Situ.join(&1.image, &1.gaze, Situ.Reproducible.linear()))
      {:ok, [{10, {:image, 2.2}}]}

  Values are numbers, `:nan`, `:infinity` or `:neg_infinity`. With `:nan` on either side the result is `:nan`. With
  `nil` on either side there is no value, and any other value is an error.

  `max_span:` allows no value between neighbours that are this far apart (ns) or farther.
  """
  @spec linear(keyword()) :: Interpolator.t()
  def linear(opts \\ []), do: adjacent(&Situ.Number.interpolate/3, opts)

  @doc """
  Computes the value with `fun.(before, after, ratio)` from the neighbours. The ratio is 0.0 at the earlier neighbour
  and 1.0 at the later one.

      iex> inputs = [image: [{10, :image}], gaze: [{7, 1}, {12, 3}]]
      iex> neighbours = Situ.Reproducible.adjacent(fn a, b, ratio -> {a, b, ratio} end)
      iex> Situ.Test.run(inputs, &Situ.join(&1.image, &1.gaze, neighbours))
      {:ok, [{10, {:image, {1, 3, 0.6}}}]}
  """
  @spec adjacent((term(), term(), float() -> term()), keyword()) :: Interpolator.t()
  def adjacent(fun, opts \\ []) when is_function(fun, 3) do
    opts = Situ.Options.validate!(opts, or_default: [type: :any], max_span: [type: :pos_integer])
    {max_span, opts} = Keyword.pop(opts, :max_span, :infinity)
    Interpolator.new(Adjacent, {fun, max_span}, [reproducible: true] ++ opts)
  end

  @doc false
  @spec left_bounded!(Interval.t()) :: :ok
  def left_bounded!(%Interval{left: :unbounded} = window) do
    raise Situ.Error.new(:not_supported, "the window #{window} has no left end",
            why: "a window without a left end has no first message",
            fix: "use a window with a bounded left end, such as [-1000000,0]"
          )
  end

  def left_bounded!(_window), do: :ok
end
