defmodule Situ.Available do
  @moduledoc """
  Interpolators that answer at once with what has arrived: quick, but **not reproducible**, since the answer depends
  on timing.

  Use them where an answer now beats the right answer later (a display, a control loop), with `Situ.fuse/4`;
  `Situ.join/4` refuses them. Windows and options are those of `Situ.Reproducible`.

      iex> messages = for {t, v} <- [{10, :a}, {20, :b}], do: %Situ.Message{originating_time: t, data: v}
      iex> Situ.Interpolator.interpolate(Situ.Available.nearest(), 24, messages, nil)
      {:created, :b, 20}
  """

  alias Situ.{Interpolator, Interval, Reproducible}
  alias Situ.Interpolator.{First, Last, Nearest}

  @doc "The message with exactly the asked time, if it has arrived."
  @spec exact(keyword()) :: Interpolator.t()
  def exact(opts \\ []), do: nearest(Interval.zero(), opts)

  @doc "The nearest arrived message in the window (default: the nearest of all)."
  @spec nearest(Reproducible.window() | keyword(), keyword()) :: Interpolator.t()
  def nearest(window \\ Interval.infinite(), opts \\ []) do
    {window, opts} = Interpolator.window(window, opts, Interval.infinite())
    Interpolator.new(Nearest, {window, false}, [gives: :messages] ++ opts)
  end

  @doc "The first arrived message in the window (default: from the asked time on)."
  @spec first(Reproducible.window() | keyword(), keyword()) :: Interpolator.t()
  def first(window \\ Interval.future(), opts \\ []) do
    {window, opts} = Interpolator.window(window, opts, Interval.future())
    Reproducible.left_bounded!(window)
    Interpolator.new(First, {window, false}, [gives: :messages] ++ opts)
  end

  @doc "The last arrived message in the window (default: up to the asked time)."
  @spec last(Reproducible.window() | keyword(), keyword()) :: Interpolator.t()
  def last(window \\ Interval.past(), opts \\ []) do
    {window, opts} = Interpolator.window(window, opts, Interval.past())
    Interpolator.new(Last, {window, false}, [gives: :messages] ++ opts)
  end
end
