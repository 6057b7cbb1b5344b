defmodule Situ.AudioStream.Ducker do
  @moduledoc false
  # The component of `Situ.AudioStream.duck/3`, which documents it. Input `:in` is the audio, and `:while` carries the
  # booleans.

  @schema [
    by: [type: {:range, 0, 120}, default: 18.0, doc: "Attenuation, dB; 120: silent."],
    fall: [type: :time_ns, default: 20_000_000, doc: "Time to lower the volume, ns."],
    rise: [type: :time_ns, default: 250_000_000, doc: "Time to restore the volume, ns."],
    hold: [
      type: :time_ns,
      default: 150_000_000,
      doc: "Time to stay quiet after the condition ends, ns, because rooms reverberate."
    ]
  ]

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer, while: :boolean],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.AudioBuffer
  alias Situ.AudioStream.Ramp

  @impl true
  def init(opts) do
    by = opts[:by]
    low = if by >= 120, do: 0.0, else: :math.pow(10, -by / 20)
    {:ok, %{opts: Map.new(opts), low: low, gain: 1.0, quiet?: false, until: nil}}
  end

  @impl true
  def handle_message(:while, %{data: true}, _context, state),
    do: {[], %{state | quiet?: true, until: nil}}

  def handle_message(:while, %{data: false, originating_time: time}, _context, state) do
    until = if state.quiet?, do: time + state.opts.hold, else: state.until
    {[], %{state | quiet?: false, until: until}}
  end

  def handle_message(:in, %{data: buffer, originating_time: time}, _context, state) do
    quiet? = state.quiet? or (state.until != nil and time <= state.until)
    target = if quiet?, do: state.low, else: 1.0
    length = max(AudioBuffer.duration_ns(buffer), 1)
    gain = Ramp.step_toward(state.gain, target, length, state.opts.rise, state.opts.fall)
    {[{:out, time, Ramp.scale_buffer(buffer, state.gain, gain)}], %{state | gain: gain}}
  end

  @impl true
  def handle_closed(:while, _time, _context, state),
    do: {[], %{state | quiet?: false, until: nil}}

  # The `:while` stream may depend on the output of this component, as it does in an assistant, so an open `:while` must
  # not keep the output open.
  def handle_closed(:in, _time, _context, state), do: {[{:close, :out}], state}

  @impl true
  def describe(%{gain: gain}), do: if(gain < 1.0, do: "quieter", else: "unchanged")
end
