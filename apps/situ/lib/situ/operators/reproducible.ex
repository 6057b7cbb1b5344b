defmodule Situ.Reproducible do
  @moduledoc """
  Interpolators that give the same values whatever the timing: they wait until no later message can change the answer.

  A window is a `Situ.Interval` of ns relative to the asked time, or a tolerance: `5` means `[-5, 5]`. Every
  function takes `or_default: value`, the value to give where there is none.

  | interpolator | value | decided when the stream has |
  |---|---|---|
  | `exact/1` | the message at the very time | reached the time |
  | `nearest/2` | the nearest in the window; of two equally near the later | reached the time, or the window's end where that is needed |
  | `first/2` | the first in the window | a message in the window or past it |
  | `last/2` | the last in the window | reached the window's end |
  | `linear/1` | the straight line between the neighbours (numbers) | reached the time |
  | `adjacent/2` | your function of the neighbours | reached the time |

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

  @doc "The message with exactly the asked time."
  @spec exact(keyword()) :: Interpolator.t()
  def exact(opts \\ []), do: nearest(Interval.zero(), opts)

  @doc "The nearest message in the window (default: the nearest of all)."
  @spec nearest(window() | keyword(), keyword()) :: Interpolator.t()
  def nearest(window \\ Interval.infinite(), opts \\ []) do
    {window, opts} = Interpolator.window(window, opts, Interval.infinite())
    Interpolator.new(Nearest, {window, true}, [reproducible: true, gives: :messages] ++ opts)
  end

  @doc "The first message in the window (default: from the asked time on). The window's left end must be bounded."
  @spec first(window() | keyword(), keyword()) :: Interpolator.t()
  def first(window \\ Interval.future(), opts \\ []) do
    {window, opts} = Interpolator.window(window, opts, Interval.future())
    left_bounded!(window)
    Interpolator.new(First, {window, true}, [reproducible: true, gives: :messages] ++ opts)
  end

  @doc "The last message in the window (default: up to the asked time)."
  @spec last(window() | keyword(), keyword()) :: Interpolator.t()
  def last(window \\ Interval.past(), opts \\ []) do
    {window, opts} = Interpolator.window(window, opts, Interval.past())
    Interpolator.new(Last, {window, true}, [reproducible: true, gives: :messages] ++ opts)
  end

  @doc """
  Linear interpolation between the messages before and after; none before the first or after the last.

  Numbers as in `Situ.Number`: with `:nan` on either side the result is `:nan`, with `nil` on either side there is
  none, and any other value is an error.

  `max_span:` gives no value between neighbours that are this far apart (ns) or farther.
  """
  @spec linear(keyword()) :: Interpolator.t()
  def linear(opts \\ []), do: adjacent(&Situ.Number.between/3, opts)

  @doc "`fun.(before, after, ratio)` of the neighbours, where ratio is 0.0 at the one before and 1.0 at the one after."
  @spec adjacent((term(), term(), float() -> term()), keyword()) :: Interpolator.t()
  def adjacent(fun, opts \\ []) when is_function(fun, 3) do
    opts = Situ.Options.validate!(opts, or_default: [type: :any], max_span: [type: :pos_integer])
    {max_span, opts} = Keyword.pop(opts, :max_span, :infinity)
    Interpolator.new(Adjacent, {fun, max_span}, [reproducible: true] ++ opts)
  end

  @doc false
  @spec left_bounded!(Interval.t()) :: :ok
  def left_bounded!(%Interval{left: :unbounded} = window) do
    raise Situ.Error.new(:not_supported, "no first message in the window #{window}",
            why: "a window without a left end has no first message",
            fix: "give it a bounded left end, as [-1000000,0]"
          )
  end

  def left_bounded!(_window), do: :ok
end
