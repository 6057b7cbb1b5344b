defmodule Situ.Media.Capture.Clock do
  @moduledoc false
  # Converts the times of a capture to originating times. A fixed clock adds one offset. A sender's clock is
  # synchronized with the pipeline's clock when its first frames arrive, and again when it jumps: a restarted sender
  # begins at zero.
  #
  # FFmpeg's muxer cannot write times that go back and replaces them with the last time plus one tick. Therefore a
  # filter marks each backward jump by adding a step that no real clock makes (`mark_jumps/0`), and this module
  # subtracts it. Both streams of a sender share its clock: the time between two jumps is an epoch with one offset.
  #
  # Without `-copyts`, FFmpeg joins the times but loses the time in between. Opening the stream
  # again at every jump costs seconds of images, and times of arrival lose the steps of the
  # sender.

  # The step of the mark in seconds and nanoseconds (115 days).
  @step_s 10_000_000
  @step @step_s * 1_000_000_000
  # The time for which the delay of a sender is measured before its first frame is passed on.
  @settle 300_000_000
  # A sender's clock that suddenly runs ahead of the pipeline's by more than this has jumped.
  @ahead 500_000_000
  # The other stream shares the clock if its frames are this close to the expected time.
  @same_clock 2_000_000_000

  defstruct [:fixed, streams: %{}, epochs: %{}]

  @typep stream :: %{out: integer(), raw: integer(), marks: non_neg_integer(), epoch: integer()}
  @typep epoch :: {:settling, until :: Situ.Time.t(), delay :: integer()} | {:set, integer()}
  @type t :: %__MODULE__{
          fixed: integer() | nil,
          streams: %{atom() => stream()},
          epochs: %{integer() => epoch()}
        }

  @doc "Builds a clock that adds `offset`, or a sender's clock if `offset` is `nil`."
  @spec new(integer() | nil) :: t()
  def new(offset), do: %__MODULE__{fixed: offset}

  @doc "Returns the expression for FFmpeg's filters `setpts` and `asetpts` that marks backward jumps."
  @spec mark_jumps() :: String.t()
  def mark_jumps,
    do: "'st(0,ld(0)+lt(PTS-PREV_INPTS,-0.5/TB));PTS+ld(0)*round(#{@step_s}/TB)'"

  @doc """
  Computes the originating time of a frame of the stream `kind` with the time `out` that arrives at `now`.

  Returns the time, `:wait` while the sender's delay is measured (the frame is skipped because the sender's backlog
  arrives in a burst), or `:jump` for the first frame after the clock jumped by `by` nanoseconds.
  """
  @spec place_frame(t(), atom(), integer(), Situ.Time.t()) ::
          {:ok, Situ.Time.t(), t()} | {:wait, t()} | {:jump, by :: integer(), t()}
  def place_frame(%__MODULE__{fixed: offset} = clock, _kind, out, _now) when is_integer(offset),
    do: {:ok, out + offset, clock}

  def place_frame(%__MODULE__{} = clock, kind, out, now) do
    case clock.streams do
      %{^kind => stream} ->
        marks = max(round((out - stream.out) / @step), 0)
        raw = out - (stream.marks + marks) * @step
        moved = %{stream | out: out, raw: raw, marks: stream.marks + marks}

        if marks > 0 or jumped_ahead?(clock, stream, raw, now),
          do: follow_jump(clock, kind, moved, raw - stream.raw, now),
          else: clock |> put_stream(kind, moved) |> read_time(kind, now)

      _ ->
        place_first(clock, kind, %{out: out, raw: out, marks: 0, epoch: 0}, now)
    end
  end

  # A sender has one clock, so its second stream joins the epoch of the first, however late it begins.
  defp place_first(%{epochs: epochs} = clock, kind, stream, now) when map_size(epochs) == 0,
    do: {:wait, clock |> put_stream(kind, stream) |> begin_epoch(0, stream.raw, now)}

  defp place_first(clock, kind, stream, now) do
    newest = clock.epochs |> Map.keys() |> Enum.max()
    clock |> put_stream(kind, %{stream | epoch: newest}) |> read_time(kind, now)
  end

  defp follow_jump(clock, kind, stream, by, now) do
    newest = clock.epochs |> Map.keys() |> Enum.max()

    if newest > stream.epoch and same_clock?(clock.epochs[newest], now - stream.raw) do
      clock |> put_stream(kind, %{stream | epoch: newest}) |> read_time(kind, now)
    else
      clock = put_stream(clock, kind, %{stream | epoch: newest + 1})
      {:jump, by, begin_epoch(clock, newest + 1, stream.raw, now)}
    end
  end

  defp begin_epoch(clock, number, raw, now) do
    oldest = clock.streams |> Map.values() |> Enum.map(& &1.epoch) |> Enum.min()
    kept = Map.filter(clock.epochs, fn {n, _} -> n >= oldest end)
    %{clock | epochs: Map.put(kept, number, {:settling, now + @settle, now - raw})}
  end

  # The smallest delay measured before `until` sets the clock.
  defp read_time(clock, kind, now) do
    %{epoch: number, raw: raw} = Map.fetch!(clock.streams, kind)

    case Map.fetch!(clock.epochs, number) do
      {:set, offset} ->
        {:ok, raw + offset, clock}

      {:settling, until, delay} when now < until ->
        {:wait, put_epoch(clock, number, {:settling, until, min(delay, now - raw)})}

      {:settling, _until, delay} ->
        offset = min(delay, now - raw)
        {:ok, raw + offset, put_epoch(clock, number, {:set, offset})}
    end
  end

  # Streams that arrive in large segments (HLS) are always ahead, but in small steps; a jump is one large step.
  defp jumped_ahead?(clock, stream, raw, now) do
    case Map.fetch!(clock.epochs, stream.epoch) do
      {:set, offset} -> raw - stream.raw > @ahead and raw + offset > now + @ahead
      _settling -> false
    end
  end

  defp same_clock?({:settling, _until, delay}, own), do: abs(own - delay) < @same_clock
  defp same_clock?({:set, offset}, own), do: abs(own - offset) < @same_clock

  defp put_stream(clock, kind, stream), do: put_in(clock.streams[kind], stream)
  defp put_epoch(clock, number, epoch), do: put_in(clock.epochs[number], epoch)
end
