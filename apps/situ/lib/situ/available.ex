defmodule Situ.Available do
  @moduledoc """
  Interpolators that use only the messages that have already arrived. They never wait, but they are
  **not reproducible**, since the result depends on timing.

  Use them with `Situ.fuse/4` where a result now beats the correct result later, as in a display or a control loop.
  `Situ.join/4` rejects them. Windows and options are the same as in `Situ.Reproducible`.

      iex> messages = for {t, v} <- [{10, :a}, {20, :b}], do: %Situ.Message{originating_time: t, data: v}
      iex> Situ.Interpolator.interpolate(Situ.Available.nearest(), 24, messages, nil)
      {:created, :b, 20}
  """

  alias Situ.{Interpolator, Interval, Reproducible}
  alias Situ.Interpolator.{First, Last, Nearest}

  @doc """
  Selects the message with exactly the requested time, if it has arrived.

      iex> t = Situ.Test.start([:image, :gaze], &Situ.fuse(&1.image, &1.gaze, Situ.Available.exact()))
      iex> Situ.Test.feed(t, :gaze, [{7, 1}, {12, 3}])
      iex> Situ.Test.advance(t, 10)
      iex> Situ.Test.feed(t, :image, {10, :image})
      iex> Situ.Test.outputs(t)
      []
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done
  """
  @spec exact(keyword()) :: Interpolator.t()
  def exact(opts \\ []), do: nearest(Interval.zero(), opts)

  @doc """
  Selects the nearest message in the window that has arrived (default: any distance).

      iex> t = Situ.Test.start([:image, :gaze], &Situ.fuse(&1.image, &1.gaze, Situ.Available.nearest()))
      iex> Situ.Test.feed(t, :gaze, [{7, 1}, {12, 3}])
      iex> Situ.Test.advance(t, 10)
      iex> Situ.Test.feed(t, :image, {10, :image})
      iex> Situ.Test.outputs(t)
      [{10, {:image, 1}}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done
  """
  @spec nearest(Reproducible.window() | keyword(), keyword()) :: Interpolator.t()
  def nearest(window \\ Interval.infinite(), opts \\ []) do
    {window, opts} = Interpolator.parse_window(window, opts, Interval.infinite())
    Interpolator.new(Nearest, {window, false}, [gives: :messages] ++ opts)
  end

  @doc """
  Selects the first message in the window that has arrived (default: at or after the requested time).

      iex> t = Situ.Test.start([:image, :gaze], &Situ.fuse(&1.image, &1.gaze, Situ.Available.first(5)))
      iex> Situ.Test.feed(t, :gaze, [{7, 1}, {12, 3}])
      iex> Situ.Test.advance(t, 10)
      iex> Situ.Test.feed(t, :image, {10, :image})
      iex> Situ.Test.outputs(t)
      [{10, {:image, 1}}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done
  """
  @spec first(Reproducible.window() | keyword(), keyword()) :: Interpolator.t()
  def first(window \\ Interval.future(), opts \\ []) do
    {window, opts} = Interpolator.parse_window(window, opts, Interval.future())
    Reproducible.left_bounded!(window)
    Interpolator.new(First, {window, false}, [gives: :messages] ++ opts)
  end

  @doc """
  Selects the last message in the window that has arrived (default: at or before the requested time).

      iex> t = Situ.Test.start([:image, :gaze], &Situ.fuse(&1.image, &1.gaze, Situ.Available.last()))
      iex> Situ.Test.feed(t, :gaze, [{7, 1}, {12, 3}])
      iex> Situ.Test.advance(t, 10)
      iex> Situ.Test.feed(t, :image, {10, :image})
      iex> Situ.Test.outputs(t)
      [{10, {:image, 1}}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done
  """
  @spec last(Reproducible.window() | keyword(), keyword()) :: Interpolator.t()
  def last(window \\ Interval.past(), opts \\ []) do
    {window, opts} = Interpolator.parse_window(window, opts, Interval.past())
    Interpolator.new(Last, {window, false}, [gives: :messages] ++ opts)
  end
end
