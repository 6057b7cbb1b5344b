defmodule Situ.Filter do
  @rate [type: :number, required: true, doc: "Samples per second."]
  @shared [
    response: [
      type: {:in, [:finite, :infinite]},
      default: :finite,
      doc: "Windowed sinc (`Situ.Filter.Fir`) or Butterworth (`Situ.Filter.Iir`)."
    ],
    order: [
      type: :pos_integer,
      doc:
        "Default 4 infinite; 64 finite, and for narrow bands so many that they are separated: " <>
          "4 times the rate over the width."
    ],
    interpolator: [
      type: {:struct, Situ.Interpolator},
      doc: "How the input is sampled, default `Situ.Reproducible.linear/1`."
    ],
    align: [type: :time_ns, doc: "Ticks congruent to this time."]
  ]
  @edge [
          rate: @rate,
          cutoff: [type: :number, required: true, doc: "Hz, above 0 and below half the rate."]
        ] ++ @shared
  @band [
          rate: @rate,
          band: [type: {:tuple, [:number, :number]}, required: true, doc: "`{low, high}` in Hz."]
        ] ++ @shared
  @denoise [order: [type: :pos_integer, default: 7, doc: "How many samples."]]
  @one_euro Situ.Filter.OneEuro.options()

  @moduledoc """
  Digital filters over streams of numbers. All are on `Situ` too: `Situ.lowpass/2` ...

  | filter | passes | input | output's time |
  |---|---|---|---|
  | `lowpass/2`, `highpass/2` | below, above `cutoff:` Hz | resampled at `rate:` | the tick |
  | `bandpass/2`, `bandstop/2` | between, outside of `band: {low, high}` Hz | resampled at `rate:` | the tick |
  | `denoise/2` | the median of the last `order:` samples | as it comes | input's |
  | `one_euro/2` | slow changes smoothed, fast ones passed (`Situ.Filter.OneEuro`) | as it comes, irregular | input's |

  The first four sample their input first, every 1/rate seconds (rounded to ns), by linear interpolation. All are
  reproducible.

  Samples are numbers as in `Situ.Number`. `:nan` and infinities are contagious, as in `Situ.Statistics`: as long as
  one lies within a median or the taps of a finite filter, and for good in an infinite one and in the 1 euro filter,
  whose outputs go into the next. `nil`, no value, comes out as it is and leaves the filter alone; so do ticks
  between a number and `nil`. Anything that is no number is an error, `:not_a_number`.

      level |> Situ.lowpass(rate: 100, cutoff: 5)
      gaze |> Situ.map(& &1.x) |> Situ.one_euro(min_cutoff: 1.5, slope: 0.01)

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable([1, 1, 50, 1], every: 10) |> Situ.denoise(order: 3) end)
      [1, 1.0, 1, 1]

  ## Options of the first four

  `rate:` (Hz), `cutoff:` or `band:`, and

  #{Situ.Options.docs(@shared)}

  All filters take the options of every operator, too (`Situ.Graph.Placement`).
  """

  alias Situ.{Argument, Fusion, Number, Operator, Reproducible, Stream}
  alias Situ.Graph.Placement
  alias Situ.Filter.{Fir, Iir, OneEuro}

  @doc "Frequencies below `cutoff:`; `rate:` in Hz."
  @spec lowpass(Stream.t(), keyword()) :: Stream.t()
  def lowpass(stream, opts), do: edge(stream, "Lowpass", :lowpass, opts)

  @doc "Frequencies above `cutoff:`; `rate:` in Hz."
  @spec highpass(Stream.t(), keyword()) :: Stream.t()
  def highpass(stream, opts), do: edge(stream, "Highpass", :highpass, opts)

  @doc "Frequencies inside of `band:`; `rate:` in Hz."
  @spec bandpass(Stream.t(), keyword()) :: Stream.t()
  def bandpass(stream, opts), do: band(stream, "Bandpass", :bandpass, opts)

  @doc "Frequencies outside of `band:`; `rate:` in Hz."
  @spec bandstop(Stream.t(), keyword()) :: Stream.t()
  def bandstop(stream, opts), do: band(stream, "Bandstop", :bandstop, opts)

  @doc "The median of the last `order:` samples (default 7; fewer at the beginning), which takes single outliers away."
  @spec denoise(Stream.t(), keyword()) :: Stream.t()
  def denoise(stream, opts \\ [])

  def denoise(%Stream{} = stream, opts) do
    {own, placed} = Placement.split!(opts, @denoise, :operator)
    order = own[:order]

    step = fn sample, past ->
      past = Enum.take([sample | past], order)
      {Number.median(past), past}
    end

    Operator.attach(stream, "Denoise", {:step, valued(step), []}, placed, :number)
  end

  def denoise(other, _arg2), do: Argument.refuse!(other, :stream, "Situ.denoise(stream)")

  @doc """
  The 1 euro filter, see `Situ.Filter.OneEuro`.

  #{Situ.Options.docs(@one_euro)}
  """
  @spec one_euro(Stream.t(), keyword()) :: Stream.t()
  def one_euro(stream, opts \\ [])

  def one_euro(%Stream{} = stream, opts) do
    {own, placed} = Placement.split!(opts, @one_euro, :operator)

    step = fn
      nil, _message, filter -> {:emit, nil, filter}
      sample, message, filter -> emit(OneEuro.step(filter, message.originating_time, sample))
    end

    Operator.attach(stream, "OneEuro", {:step, step, OneEuro.new(own)}, placed, :number)
  end

  def one_euro(other, _arg2), do: Argument.refuse!(other, :stream, "Situ.one_euro(stream)")

  defp edge(stream, name, shape, opts) do
    stream = Argument.stream!(stream, "Situ.#{shape}(stream, cutoff: 3, rate: 100)")
    {own, placed} = Placement.split!(opts, @edge, :operator)
    attach(stream, name, {shape, [own[:cutoff]]}, own, placed)
  end

  defp band(stream, name, shape, opts) do
    stream = Argument.stream!(stream, "Situ.#{shape}(stream, band: {2, 9}, rate: 100)")
    {own, placed} = Placement.split!(opts, @band, :operator)
    attach(stream, name, {shape, Tuple.to_list(own[:band])}, own, placed)
  end

  defp attach(%Stream{} = stream, name, {shape, edges}, own, placed) do
    rate = own[:rate]
    check!(rate, edges)
    interpolator = own[:interpolator] || Reproducible.linear()
    clock = if own[:align], do: [align: own[:align]], else: []

    {module, order} =
      if own[:response] == :finite, do: {Fir, finite_order(rate, edges)}, else: {Iir, 4}

    filter = module.new(shape, rate, edges, own[:order] || order)
    step = valued(fn sample, filter -> module.step(filter, sample) end)

    stream
    |> Fusion.interpolate(round(1.0e9 / rate), interpolator, clock)
    |> Operator.attach(name, {:step, step, filter}, placed, :float)
  end

  @most 4096
  defp finite_order(_rate, [_cutoff]), do: 64

  defp finite_order(rate, [low, high]),
    do: (2 * ceil(2 * rate / max(high - low, 1.0e-9))) |> max(64) |> min(@most)

  defp check!(rate, edges) do
    unless is_number(rate) and rate > 0 do
      raise ArgumentError, "a rate is a number of Hz above 0, got: #{inspect(rate)}"
    end

    unless Enum.all?(edges, &(&1 > 0 and &1 < rate / 2)) and edges == Enum.sort(edges) do
      raise ArgumentError,
            "edges rise and lie between 0 and #{rate / 2} Hz (half the rate), got: #{inspect(edges)}"
    end
  end

  # No value is no sample: it comes out as it is.
  defp valued(step) do
    fn
      nil, _message, state -> {:emit, nil, state}
      sample, _message, state -> emit(step.(sample, state))
    end
  end

  defp emit({out, state}), do: {:emit, out, state}
end
