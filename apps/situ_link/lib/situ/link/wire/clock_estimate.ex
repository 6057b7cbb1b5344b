defmodule Situ.Link.Wire.ClockEstimate do
  @moduledoc false
  # Estimates from round trips how far the remote clock is ahead of the local one, and how fast
  # that changes. Pure.
  #
  # A round trip consists of four times: sent at `t0` and back at `t3` by the local clock,
  # received at `t1` and returned at `t2` by the remote clock. It shows an offset of `((t1 - t0) +
  # (t2 - t3)) / 2`. The error is at most half of the network delay, however that delay is split
  # between the two directions (RFC 5905, section 8). Quick round trips therefore count most.
  # Offset and drift are a line fitted to the samples of the last minutes, each weighted by how
  # much longer it took than the quickest one. If one of the clocks was set, earlier samples are
  # discarded.
  # About four minutes, at one round trip a second.
  @max_samples 256
  @min_samples 8
  @min_span 10_000_000_000
  # The crystals of computers stay within this drift, so larger values are clamped.
  @max_drift 500.0e-6
  @max_outliers 3

  defstruct samples: [], offset: 0.0, drift: 0.0, at: nil, rtt: nil, error: 0.0, outliers: 0

  @typedoc "`offset` (remote minus local, ns) at local time `at`, `drift` (ns per ns), `rtt` of the quickest trip (ns)."
  @type t :: %__MODULE__{}
  @type trip :: {Situ.Time.t(), Situ.Time.t(), Situ.Time.t(), Situ.Time.t()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Adds a round trip and updates the estimate. Round trips with a negative duration are ignored.

      iex> alias Situ.Link.Wire.ClockEstimate
      iex> clock = ClockEstimate.add_round_trip(ClockEstimate.new(), {1_000, 6_100, 6_200, 1_300})
      iex> {ClockEstimate.offset_at(clock, 1_300), ClockEstimate.uncertainty_at(clock, 1_300)}
      {5_000, 100}
  """
  @spec add_round_trip(t(), trip()) :: t()
  def add_round_trip(%__MODULE__{} = clock, {t0, t1, t2, t3}) when t3 >= t0 and t2 >= t1 do
    rtt = max(t3 - t0 - (t2 - t1), 0)
    offset = (t1 - t0 + (t2 - t3)) / 2
    clock |> detect_step({t3, offset, rtt}) |> add_sample({t3, offset, rtt})
  end

  def add_round_trip(%__MODULE__{} = clock, _trip), do: clock

  # Three unexplained samples in a row mean that a clock was set.
  defp detect_step(%{at: nil} = clock, _sample), do: clock

  defp detect_step(clock, {at, offset, rtt}) do
    possible = rtt / 2 + uncertainty_at(clock, at) + 1_000_000

    cond do
      Kernel.abs(offset - offset_at(clock, at)) <= possible ->
        %{clock | outliers: 0}

      clock.outliers + 1 >= @max_outliers ->
        %{new() | samples: Enum.take(clock.samples, @max_outliers - 1)}

      true ->
        %{clock | outliers: clock.outliers + 1}
    end
  end

  defp add_sample(clock, sample),
    do: update_estimate(%{clock | samples: Enum.take([sample | clock.samples], @max_samples)})

  defp update_estimate(%{samples: [{at, _, _} | _] = samples} = clock) do
    rtt = samples |> Enum.map(&elem(&1, 2)) |> Enum.min()
    {oldest, _, _} = List.last(samples)

    if length(samples) >= @min_samples and at - oldest >= @min_span,
      do: fit_line(%{clock | at: at, rtt: rtt}),
      else: use_quickest_trip(%{clock | at: at, rtt: rtt})
  end

  # If two trips were equally quick, `Enum.min_by/2` returns the later one, which is first in the list.
  defp use_quickest_trip(clock) do
    {at, offset, rtt} = Enum.min_by(clock.samples, &elem(&1, 2))
    %{clock | offset: offset, drift: 0.0, at: at, error: rtt / 2}
  end

  defp fit_line(%{samples: samples, rtt: quickest, at: at} = clock) do
    weighted =
      for {t, offset, rtt} <- samples do
        late = (rtt - quickest) / 2 + quickest / 20 + 1_000
        {1 / (late * late), (t - at) / 1, offset}
      end

    sum = fn f -> weighted |> Enum.map(f) |> Enum.sum() end
    w = sum.(fn {w, _, _} -> w end)
    mean_t = sum.(fn {w, t, _} -> w * t end) / w
    mean_o = sum.(fn {w, _, o} -> w * o end) / w
    spread = sum.(fn {w, t, _} -> w * (t - mean_t) * (t - mean_t) end)
    covariance = sum.(fn {w, t, o} -> w * (t - mean_t) * (o - mean_o) end)
    drift = if spread > 0, do: covariance / spread, else: 0.0
    drift = drift |> max(-@max_drift) |> min(@max_drift)
    %{clock | offset: mean_o - drift * mean_t, drift: drift, error: quickest / 2}
  end

  @doc "Returns the offset (remote minus local clock, ns) at the local time `now`, or 0 before the first round trip."
  @spec offset_at(t(), Situ.Time.t()) :: integer()
  def offset_at(%__MODULE__{at: nil}, _now), do: 0

  def offset_at(%__MODULE__{} = clock, now),
    do: round(clock.offset + clock.drift * (now - clock.at))

  @doc """
  Returns the uncertainty of the offset in ns: half of the quickest round trip, and 20 ppm of the time since the
  estimate. Returns `nil` before the first round trip.
  """
  @spec uncertainty_at(t(), Situ.Time.t()) :: non_neg_integer() | nil
  def uncertainty_at(%__MODULE__{at: nil}, _now), do: nil

  def uncertainty_at(%__MODULE__{} = clock, now),
    do: round(clock.error + 20.0e-6 * Kernel.abs(now - clock.at))

  @doc "Converts a time of the remote clock to the local clock."
  @spec to_local_time(t(), Situ.Time.t()) :: Situ.Time.t()
  def to_local_time(%__MODULE__{at: nil}, time), do: time

  # The offset is a function of the local time, which is the unknown. One step is exact to the square of the drift.
  def to_local_time(%__MODULE__{} = clock, time),
    do: time - offset_at(clock, time - round(clock.offset))
end
