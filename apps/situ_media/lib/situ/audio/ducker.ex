defmodule Situ.Audio.Ducker do
  @schema [
    by: [type: {:range, 0, 120}, default: 18.0, doc: "How much quieter, dB; 120: silent."],
    fall: [type: :time_ns, default: 20_000_000, doc: "How long it takes to get quieter, ns."],
    rise: [type: :time_ns, default: 250_000_000, doc: "How long it takes to come back, ns."],
    hold: [
      type: :time_ns,
      default: 150_000_000,
      doc: "How long it stays quiet after that is over, ns: rooms go on sounding."
    ]
  ]

  @moduledoc """
  Makes a sound quieter while something else is the case (`Situ.Audio.duck/3`): a microphone while the loudspeaker
  speaks, music while somebody talks.

  Input `:in` is the sound, `:while` booleans, at least one for each change. A buffer goes by the last boolean at or
  before its end that has come: live, one that comes late counts from then on; of recordings, all are there in time.
  Nothing waits, and times and lengths stay as they are. The factor moves in straight lines, so that nothing clicks.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [in: Situ.AudioBuffer, while: :boolean],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.AudioBuffer
  alias Situ.Audio.Ramp

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
    length = max(AudioBuffer.duration(buffer), 1)
    gain = Ramp.toward(state.gain, target, length, state.opts.rise, state.opts.fall)
    {[{:out, time, Ramp.apply(buffer, state.gain, gain)}], %{state | gain: gain}}
  end

  @impl true
  def handle_closed(:while, _time, _context, state),
    do: {[], %{state | quiet?: false, until: nil}}

  # The stream that says when to be quiet may depend on this one's output, as an assistant's does: that does not keep
  # it open.
  def handle_closed(:in, _time, _context, state), do: {[{:close, :out}], state}

  @impl true
  def describe(%{gain: gain}), do: if(gain < 1.0, do: "quieter", else: "as it is")
end
