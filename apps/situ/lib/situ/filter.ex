defmodule Situ.Filter do
  @moduledoc false
  # Digital filters over streams of numbers. `Situ` documents them.

  @rate [type: :number, required: true, doc: "Samples per second."]
  @shared [
    response: [
      type: {:in, [:finite, :infinite]},
      default: :finite,
      doc: "Windowed sinc (`:finite`) or Butterworth (`:infinite`)."
    ],
    order: [
      type: :pos_integer,
      doc:
        "Default: 4 for infinite filters; for finite ones 64, or 4 times the rate divided by the width " <>
          "of a narrow band, so that its edges are separated."
    ],
    interpolator: [
      type: {:struct, Situ.Interpolator},
      doc: "Interpolator that samples the input, default `Situ.Reproducible.linear/1`."
    ],
    align: [type: :time_ns, doc: "Aligns ticks to times congruent to this one."]
  ]
  @edge [
          rate: @rate,
          cutoff: [
            type: :number,
            required: true,
            doc: "Cutoff in Hz, above 0 and below half the rate."
          ]
        ] ++ @shared
  @band [
          rate: @rate,
          band: [type: {:tuple, [:number, :number]}, required: true, doc: "`{low, high}` in Hz."]
        ] ++ @shared
  @denoise [order: [type: :pos_integer, default: 7, doc: "Number of samples."]]
  @one_euro Situ.Filter.OneEuro.option_schema()

  alias Situ.{Argument, Fusion, Number, Operator, Reproducible, Stream}
  alias Situ.Graph.Placement
  alias Situ.Filter.{Fir, Iir, OneEuro}

  @spec option_schema(:edge | :band | :denoise | :one_euro) :: Situ.Options.schema()
  def option_schema(:edge), do: @edge
  def option_schema(:band), do: @band
  def option_schema(:denoise), do: @denoise
  def option_schema(:one_euro), do: @one_euro

  def lowpass(stream, opts), do: attach_edge_filter(stream, "Lowpass", :lowpass, opts)

  def highpass(stream, opts), do: attach_edge_filter(stream, "Highpass", :highpass, opts)

  def bandpass(stream, opts), do: attach_band_filter(stream, "Bandpass", :bandpass, opts)

  def bandstop(stream, opts), do: attach_band_filter(stream, "Bandstop", :bandstop, opts)

  def denoise(%Stream{} = stream, opts) do
    {own, placement} = Placement.split_options!(opts, @denoise, :operator)
    order = own[:order]

    step = fn sample, past ->
      past = Enum.take([sample | past], order)
      {Number.median(past), past}
    end

    Operator.attach(stream, "Denoise", {:step, pass_nil_through(step), []}, placement, :number)
  end

  def denoise(other, _arg2), do: Argument.raise_invalid!(other, :stream, "Situ.denoise(stream)")

  def one_euro(%Stream{} = stream, opts) do
    {own, placement} = Placement.split_options!(opts, @one_euro, :operator)

    step = fn
      nil, _message, filter ->
        {:emit, nil, filter}

      sample, message, filter ->
        emit_sample(OneEuro.step(filter, message.originating_time, sample))
    end

    Operator.attach(stream, "OneEuro", {:step, step, OneEuro.new(own)}, placement, :number)
  end

  def one_euro(other, _arg2), do: Argument.raise_invalid!(other, :stream, "Situ.one_euro(stream)")

  defp attach_edge_filter(stream, name, shape, opts) do
    stream = Argument.ensure_stream!(stream, "Situ.#{shape}(stream, cutoff: 3, rate: 100)")
    {own, placement} = Placement.split_options!(opts, @edge, :operator)
    attach_filter(stream, name, {shape, [own[:cutoff]]}, own, placement)
  end

  defp attach_band_filter(stream, name, shape, opts) do
    stream = Argument.ensure_stream!(stream, "Situ.#{shape}(stream, band: {2, 9}, rate: 100)")
    {own, placement} = Placement.split_options!(opts, @band, :operator)
    attach_filter(stream, name, {shape, Tuple.to_list(own[:band])}, own, placement)
  end

  defp attach_filter(%Stream{} = stream, name, {shape, edges}, own, placement) do
    rate = own[:rate]
    validate_edges!(rate, edges)
    interpolator = own[:interpolator] || Reproducible.linear()
    clock = if own[:align], do: [align: own[:align]], else: []

    {module, order} =
      if own[:response] == :finite, do: {Fir, finite_order(rate, edges)}, else: {Iir, 4}

    filter = module.new(shape, rate, edges, own[:order] || order)
    step = pass_nil_through(fn sample, filter -> module.step(filter, sample) end)

    stream
    |> Fusion.sample(round(1.0e9 / rate), interpolator, clock)
    |> Operator.attach(name, {:step, step, filter}, placement, :float)
  end

  @most 4096
  defp finite_order(_rate, [_cutoff]), do: 64

  defp finite_order(rate, [low, high]),
    do: (2 * ceil(2 * rate / max(high - low, 1.0e-9))) |> max(64) |> min(@most)

  defp validate_edges!(rate, edges) do
    unless is_number(rate) and rate > 0 do
      raise ArgumentError, "rate: must be a number of Hz above 0, got: #{inspect(rate)}"
    end

    unless Enum.all?(edges, &(&1 > 0 and &1 < rate / 2)) and edges == Enum.sort(edges) do
      raise ArgumentError,
            "edges must increase, between 0 and #{rate / 2} Hz (half the rate), got: #{inspect(edges)}"
    end
  end

  # `nil` is not a sample, so it passes through without changing the state.
  defp pass_nil_through(step) do
    fn
      nil, _message, state -> {:emit, nil, state}
      sample, _message, state -> emit_sample(step.(sample, state))
    end
  end

  defp emit_sample({out, state}), do: {:emit, out, state}
end
