defmodule Situ.Filter do
  @moduledoc """
  Digital filters over streams of numbers. All are on `Situ` too: `Situ.lowpass/3` ...

  | filter | passes | input | output's time |
  |---|---|---|---|
  | `lowpass/3`, `highpass/3` | below, above `cutoff:` Hz | resampled at `rate:` | the tick |
  | `bandpass/3`, `bandstop/3` | between, outside of `band: {low, high}` Hz | resampled at `rate:` | the tick |
  | `denoise/2` | the median of the last `order:` samples | as it comes | input's |
  | `one_euro/2` | slow changes smoothed, fast ones passed (`Situ.Filter.OneEuro`) | as it comes, irregular | input's |

  The first four sample their input first, every 1/rate seconds (rounded to ns), by linear interpolation. All are reproducible.

  Samples are numbers as in `Situ.Number`. `:nan` and infinities are contagious, as in `Situ.Statistics`: as long as one lies within a median or the
  taps of a finite filter, and for good in an infinite one and in the 1 euro filter, whose outputs go into the next. `nil`, no value, comes out
  as it is and leaves the filter alone; so do ticks between a number and `nil`. What is no number is an error, `:not_a_number`.

      level |> Situ.lowpass(100, cutoff: 5)
      gaze |> Situ.map(& &1.x) |> Situ.one_euro(min_cutoff: 1.5, slope: 0.01)

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable([1, 1, 50, 1], interval: 10) |> Situ.denoise(order: 3) end)
      [1, 1.0, 1, 1]

  ## Options of the first four

  #{Situ.Options.docs(cutoff: [type: :number, doc: "Hz, above 0 and below half the rate."], band: [type: :any, doc: "`{low, high}` in Hz."], response: [type: {:in, [:finite, :infinite]}, default: :finite, doc: "Windowed sinc (`Situ.Filter.Fir`) or Butterworth (`Situ.Filter.Iir`)."], order: [type: :pos_integer, doc: "Default 64 finite, 4 infinite."], interpolator: [type: :any, doc: "Default `Situ.Reproducible.linear/1`."], align: [type: :time_ns, doc: "Ticks congruent to this time."])}
  """

  alias Situ.{Fusion, Number, Operator, Options, Reproducible, Stream}
  alias Situ.Filter.{Fir, Iir, OneEuro}

  @shared [
    response: [type: {:in, [:finite, :infinite]}, default: :finite],
    order: [type: :pos_integer],
    interpolator: [type: :any],
    align: [type: :time_ns]
  ]

  @doc "Frequencies below `cutoff:`; `rate` in Hz."
  @spec lowpass(Stream.t(), number(), keyword()) :: Stream.t()
  def lowpass(stream, rate, opts), do: edge(stream, "Lowpass", :lowpass, rate, opts)

  @doc "Frequencies above `cutoff:`; `rate` in Hz."
  @spec highpass(Stream.t(), number(), keyword()) :: Stream.t()
  def highpass(stream, rate, opts), do: edge(stream, "Highpass", :highpass, rate, opts)

  @doc "Frequencies inside of `band:`; `rate` in Hz."
  @spec bandpass(Stream.t(), number(), keyword()) :: Stream.t()
  def bandpass(stream, rate, opts), do: band(stream, "Bandpass", :bandpass, rate, opts)

  @doc "Frequencies outside of `band:`; `rate` in Hz."
  @spec bandstop(Stream.t(), number(), keyword()) :: Stream.t()
  def bandstop(stream, rate, opts), do: band(stream, "Bandstop", :bandstop, rate, opts)

  @doc "The median of the last `order:` samples (default 7; fewer at the beginning), which takes single outliers away."
  @spec denoise(Stream.t(), keyword()) :: Stream.t()
  def denoise(%Stream{} = stream, opts \\ []) do
    {own, opts} = Keyword.split(opts, [:order])
    own = Options.validate!(own, order: [type: :pos_integer, default: 7])
    order = own[:order]

    step = fn sample, past ->
      past = Enum.take([sample | past], order)
      {Number.median(past), past}
    end

    Operator.attach(stream, "Denoise", {:step, valued(step), []}, opts, :number)
  end

  @doc "The 1 euro filter; options of `Situ.Filter.OneEuro.new/1`."
  @spec one_euro(Stream.t(), keyword()) :: Stream.t()
  def one_euro(%Stream{} = stream, opts \\ []) do
    {own, opts} = Keyword.split(opts, [:slope, :min_cutoff, :derivative_cutoff])

    step = fn
      nil, _message, filter -> {:emit, nil, filter}
      sample, message, filter -> emit(OneEuro.step(filter, message.originating_time, sample))
    end

    Operator.attach(stream, "OneEuro", {:step, step, OneEuro.new(own)}, opts, :number)
  end

  defp edge(stream, name, shape, rate, opts) do
    {own, opts} = Keyword.split(opts, [:cutoff | Keyword.keys(@shared)])
    own = Options.validate!(own, [cutoff: [type: :number, required: true]] ++ @shared)
    attach(stream, name, {shape, rate, [own[:cutoff]]}, own, opts)
  end

  defp band(stream, name, shape, rate, opts) do
    {own, opts} = Keyword.split(opts, [:band | Keyword.keys(@shared)])
    pair = {:tuple, [:number, :number]}
    own = Options.validate!(own, [band: [type: pair, required: true]] ++ @shared)
    attach(stream, name, {shape, rate, Tuple.to_list(own[:band])}, own, opts)
  end

  defp attach(%Stream{} = stream, name, {shape, rate, edges}, own, opts) do
    check!(rate, edges)
    interpolator = own[:interpolator] || Reproducible.linear()
    interval = round(1.0e9 / rate)
    clock = if own[:align], do: [align: own[:align]], else: []
    {module, order} = if own[:response] == :finite, do: {Fir, 64}, else: {Iir, 4}
    filter = module.new(shape, rate, edges, own[:order] || order)

    step = valued(fn sample, filter -> module.step(filter, sample) end)

    stream
    |> Fusion.interpolate(interval, interpolator, clock)
    |> Operator.attach(name, {:step, step, filter}, opts, :float)
  end

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
