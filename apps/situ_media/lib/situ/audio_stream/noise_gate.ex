defmodule Situ.AudioStream.NoiseGate do
  @moduledoc false
  # The component of `Situ.AudioStream.noise_gate/2`, which documents it and cuts the audio into buffers of 10 ms first.

  @schema [
    open: [
      type: {:range, -120, 0},
      default: -45.0,
      doc: "The gate opens at this level, dB of full scale (root mean square of 10 ms)."
    ],
    close: [
      type: {:optional, {:range, -120, 0}},
      default: nil,
      doc: "The gate closes below this level; `nil`: 6 dB below `open:`."
    ],
    hold: [
      type: :time_ns,
      default: 150_000_000,
      doc: "Time the gate stays open below `close:`, ns."
    ],
    attack: [type: :time_ns, default: 5_000_000, doc: "Time to open, ns."],
    release: [type: :time_ns, default: 100_000_000, doc: "Time to close, ns."],
    floor: [
      type: {:range, -120, 0},
      default: -120.0,
      doc: "The gain of a closed gate, dB; -120: silence."
    ]
  ]

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.{AudioBuffer, Error, AudioOps}
  alias Situ.AudioStream.Ramp

  @impl true
  def init(opts) do
    opts = Map.new(opts)
    opts = %{opts | close: opts.close || opts.open - 6}

    if opts.close > opts.open,
      do:
        {:error,
         Error.new(:bad_option, "option close: must not be above open:",
           fix: "set close: to #{opts.open} dB or less"
         )},
      else:
        {:ok,
         %{opts: opts, floor: db_to_factor(opts.floor), gain: db_to_factor(opts.floor), held: 0}}
  end

  defp db_to_factor(db) when db <= -120, do: 0.0
  defp db_to_factor(db), do: :math.pow(10, db / 20)

  @impl true
  def handle_message(:in, %{data: buffer, originating_time: time}, _context, state) do
    length = max(AudioBuffer.duration_ns(buffer), 1)
    state = update_hold(state, AudioOps.level!(buffer).rms_db, length)
    target = if state.held > 0, do: 1.0, else: state.floor
    gain = Ramp.step_toward(state.gain, target, length, state.opts.attack, state.opts.release)
    {[{:out, time, Ramp.scale_buffer(buffer, state.gain, gain)}], %{state | gain: gain}}
  end

  # `held` is the remaining time for which the gate stays open.
  defp update_hold(%{held: held, opts: opts} = state, level, length) do
    cond do
      level >= opts.open or (held > 0 and level >= opts.close) ->
        %{state | held: opts.hold + length}

      true ->
        %{state | held: max(held - length, 0)}
    end
  end

  @impl true
  def describe(%{held: 0}), do: "closed"
  def describe(_state), do: "open"
end
