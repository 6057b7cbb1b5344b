defmodule Situ.Remote.Link.ClockEstimate do
  @moduledoc """
  How far the other side's clock is ahead of ours, and how fast that changes, from round trips. Pure.

  A round trip is four times: sent at `t0` and back at `t3` by our clock, received at `t1` and answered at `t2` by
  theirs. It shows an offset of `((t1 - t0) + (t2 - t3)) / 2`, wrong by at most half of the time it was on its way,
  whatever the ways there and back (RFC 5905, section 8). So quick round trips count most: the offset and the drift are
  a line through the last minutes' samples, each weighted by how much longer than the quickest it took. Where a clock
  was set, what was known before is let go.

      iex> alias Situ.Remote.Link.ClockEstimate
      iex> clock = ClockEstimate.add(ClockEstimate.new(), {1_000, 6_100, 6_200, 1_300})
      iex> {ClockEstimate.offset(clock, 1_300), ClockEstimate.uncertainty(clock, 1_300)}
      {5_000, 100}
  """
  # About four minutes of one round trip a second.
  @most 256
  @least_for_drift 8
  @least_span 10_000_000_000
  # Crystals of computers stay within this; nothing more is believed.
  @most_drift 500.0e-6
  @steps 3

  defstruct samples: [], offset: 0.0, drift: 0.0, at: nil, rtt: nil, error: 0.0, odd: 0

  @typedoc "`offset` (ns, theirs minus ours) at our time `at`, `drift` in ns per ns; `rtt` is the quickest one, ns."
  @type t :: %__MODULE__{}
  @type trip :: {Situ.Time.t(), Situ.Time.t(), Situ.Time.t(), Situ.Time.t()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "One more round trip. One that took less than no time is none."
  @spec add(t(), trip()) :: t()
  def add(%__MODULE__{} = clock, {t0, t1, t2, t3}) when t3 >= t0 and t2 >= t1 do
    rtt = max(t3 - t0 - (t2 - t1), 0)
    offset = (t1 - t0 + (t2 - t3)) / 2
    clock |> stepped({t3, offset, rtt}) |> take({t3, offset, rtt})
  end

  def add(%__MODULE__{} = clock, _trip), do: clock

  # Three in a row that cannot be explained: a clock was set.
  defp stepped(%{at: nil} = clock, _sample), do: clock

  defp stepped(clock, {at, offset, rtt}) do
    possible = rtt / 2 + uncertainty(clock, at) + 1_000_000

    cond do
      Kernel.abs(offset - offset(clock, at)) <= possible -> %{clock | odd: 0}
      clock.odd + 1 >= @steps -> %{new() | samples: Enum.take(clock.samples, @steps - 1)}
      true -> %{clock | odd: clock.odd + 1}
    end
  end

  defp take(clock, sample),
    do: fit(%{clock | samples: Enum.take([sample | clock.samples], @most)})

  defp fit(%{samples: [{at, _, _} | _] = samples} = clock) do
    rtt = samples |> Enum.map(&elem(&1, 2)) |> Enum.min()
    {oldest, _, _} = List.last(samples)

    if length(samples) >= @least_for_drift and at - oldest >= @least_span,
      do: line(%{clock | at: at, rtt: rtt}),
      else: quickest(%{clock | at: at, rtt: rtt})
  end

  # Of two equally quick ones the later.
  defp quickest(clock) do
    {at, offset, rtt} = Enum.min_by(clock.samples, &elem(&1, 2))
    %{clock | offset: offset, drift: 0.0, at: at, error: rtt / 2}
  end

  defp line(%{samples: samples, rtt: quickest, at: at} = clock) do
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
    both = sum.(fn {w, t, o} -> w * (t - mean_t) * (o - mean_o) end)
    drift = if spread > 0, do: both / spread, else: 0.0
    drift = drift |> max(-@most_drift) |> min(@most_drift)
    %{clock | offset: mean_o - drift * mean_t, drift: drift, error: quickest / 2}
  end

  @doc "Theirs minus ours at our time `now`, ns; 0 before the first round trip."
  @spec offset(t(), Situ.Time.t()) :: integer()
  def offset(%__MODULE__{at: nil}, _now), do: 0
  def offset(%__MODULE__{} = clock, now), do: round(clock.offset + clock.drift * (now - clock.at))

  @doc "How wrong that may be, ns: half of the quickest round trip, and 20 ppm of the time since; `nil` at first."
  @spec uncertainty(t(), Situ.Time.t()) :: non_neg_integer() | nil
  def uncertainty(%__MODULE__{at: nil}, _now), do: nil

  def uncertainty(%__MODULE__{} = clock, now),
    do: round(clock.error + 20.0e-6 * Kernel.abs(now - clock.at))

  @doc "A time of theirs by our clock."
  @spec to_ours(t(), Situ.Time.t()) :: Situ.Time.t()
  def to_ours(%__MODULE__{at: nil}, time), do: time

  # The offset belongs to our time, which is what is looked for: one step is exact to the square of the drift.
  def to_ours(%__MODULE__{} = clock, time), do: time - offset(clock, time - round(clock.offset))
end
