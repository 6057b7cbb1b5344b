defmodule Situ.Media.Capture.Clock do
  @moduledoc false
  # Turns the times of a capture into originating times. A fixed clock adds one offset. A sender's clock is set to the
  # pipeline's clock when its first frames arrive, and set again when it jumps: a sender that restarts begins at zero.
  #
  # FFmpeg's muxer cannot write times that go back: it replaces them by the last time and one tick. So a filter marks
  # each jump backwards by adding a step that no real clock makes (`mark_jumps/0`), and this module subtracts it again.
  # Both streams of a sender share its clock: the time between two jumps is an epoch with one offset.

  # One step of the mark, in seconds and in nanoseconds: 115 days.
  @step_s 10_000_000
  @step @step_s * 1_000_000_000
  # How long the delay of a sender is measured before its first frame is let through.
  @settle 300_000_000
  # A sender's clock that runs ahead of the pipeline's by more than this, at once, has jumped.
  @ahead 500_000_000
  # The other stream has the same clock if its frames come this near to where that clock expects them.
  @same_clock 2_000_000_000

  defstruct [:fixed, streams: %{}, epochs: %{}]

  @typep stream :: %{out: integer(), raw: integer(), marks: non_neg_integer(), epoch: integer()}
  @typep epoch :: {:settling, until :: Situ.Time.t(), delay :: integer()} | {:set, integer()}
  @type t :: %__MODULE__{
          fixed: integer() | nil,
          streams: %{atom() => stream()},
          epochs: %{integer() => epoch()}
        }

  @doc "Returns a clock that adds `offset`, or for `nil` the clock of a sender."
  @spec new(integer() | nil) :: t()
  def new(offset), do: %__MODULE__{fixed: offset}

  @doc "Returns the expression for FFmpeg's filters `setpts` and `asetpts` that marks jumps backwards."
  @spec mark_jumps() :: String.t()
  def mark_jumps,
    do: "'st(0,ld(0)+lt(PTS-PREV_INPTS,-0.5/TB));PTS+ld(0)*round(#{@step_s}/TB)'"

  @doc """
  Places a frame of the stream `kind` with the time `out`, which arrives at `now`.

  Returns its originating time, `:wait` while the sender's delay is measured (the frame is left out: the sender's
  backlog comes in a burst), or `:jump` for the first frame after the clock jumped by `by` nanoseconds.
  """
  @spec place(t(), atom(), integer(), Situ.Time.t()) ::
          {:ok, Situ.Time.t(), t()} | {:wait, t()} | {:jump, by :: integer(), t()}
  def place(%__MODULE__{fixed: offset} = clock, _kind, out, _now) when is_integer(offset),
    do: {:ok, out + offset, clock}

  def place(%__MODULE__{} = clock, kind, out, now) do
    case clock.streams do
      %{^kind => stream} ->
        marks = max(round((out - stream.out) / @step), 0)
        raw = out - (stream.marks + marks) * @step
        moved = %{stream | out: out, raw: raw, marks: stream.marks + marks}

        if marks > 0 or ahead?(clock, stream, raw, now),
          do: follow_jump(clock, kind, moved, raw - stream.raw, now),
          else: clock |> put_stream(kind, moved) |> read_time(kind, now)

      _ ->
        place_first(clock, kind, %{out: out, raw: out, marks: 0, epoch: 0}, now)
    end
  end

  # A sender has one clock, so its second stream joins the first one's, however late it begins.
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

  # The smallest delay during the first moments sets the clock.
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
  defp ahead?(clock, stream, raw, now) do
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
