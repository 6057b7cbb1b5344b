defmodule Situ.Audio.Reframer do
  @schema [
    frames: [type: {:optional, :pos_integer}, default: nil, doc: "Frames of each buffer; or"],
    duration: [
      type: {:optional, {:integer, 1, 0x7FFFFFFFFFFFFFFF}},
      default: nil,
      doc: "Its duration, ns, rounded up to whole frames."
    ],
    hop: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Frames from one buffer to the next: less makes them overlap. Default: no overlap."
    ],
    tail: [
      type: {:in, [:drop, :keep, :pad]},
      default: :drop,
      doc:
        "Fewer frames than asked for at the end: drop them, keep them as a shorter piece, or " <>
          "pad them with silence."
    ]
  ]

  @moduledoc """
  Cuts sound into buffers of an exact size, whatever the size it comes in (`Situ.Audio.reframe/2`).

  The time of each is the input's time less what follows it in that input, so exact to the sample. Where that would
  not be later than the buffer before (inputs whose times do not agree with their lengths), it is 1 ns later. When the
  format changes, what is left of the old one goes as `tail:` says; the time of that last buffer is when its sound
  ends, without the silence that fills it up.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}

  @impl true
  def init(opts) do
    case {opts[:frames], opts[:duration]} do
      {nil, nil} -> {:error, Error.new(:missing_option, "reframe needs frames: or duration:")}
      {n, nil} when n != nil -> state(opts)
      {nil, _} -> state(opts)
      _ -> {:error, Error.new(:bad_option, "give frames: or duration:, not both")}
    end
  end

  defp state(opts),
    do: {:ok, %{opts: opts, format: nil, size: nil, hop: nil, rest: "", seen: nil, last: nil}}

  @impl true
  def handle_message(:in, %{data: buffer, originating_time: time}, _context, state) do
    {flushed, state} = follow(state, buffer.format)
    data = if state.rest == "", do: buffer.data, else: state.rest <> buffer.data
    {actions, rest, last} = cut(data, time, state, [])
    # A small remainder must not keep a large buffer alive.
    {flushed ++ actions, %{state | rest: :binary.copy(rest), last: last, seen: time}}
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: finish(state)

  defp follow(%{format: format} = state, format), do: {[], state}

  defp follow(%{opts: opts} = state, format) do
    {actions, state} = finish(state)
    bytes = AudioFormat.bytes_per_frame(format)
    frames = opts[:frames] || ceil_frames(opts[:duration], format.rate)

    state = %{
      state
      | format: format,
        size: frames * bytes,
        hop: (opts[:hop] || frames) * bytes,
        rest: ""
    }

    {actions, state}
  end

  defp ceil_frames(ns, rate), do: -Integer.floor_div(-ns * rate, 1_000_000_000)

  defp cut(data, time, %{size: size, hop: hop} = state, actions) when byte_size(data) >= size do
    after_it = byte_size(data) - size
    at = later(time - span(state.format, after_it), state.last)
    out = %AudioBuffer{format: state.format, data: binary_part(data, 0, size)}
    skip = min(hop, byte_size(data))
    rest = binary_part(data, skip, byte_size(data) - skip)
    # A hop beyond the frame skips what has not come yet: not offered, hop is at most the size.
    cut(rest, time, %{state | last: at}, [{:out, at, out} | actions])
  end

  defp cut(data, _time, state, actions), do: {Enum.reverse(actions), data, state.last}

  defp finish(%{rest: ""} = state), do: {[], state}

  defp finish(%{opts: opts, rest: rest} = state) do
    # The silence that fills it up would end after the input has, where nothing may be emitted.
    time = later(state.seen, state.last)

    case opts[:tail] do
      :drop ->
        {[], %{state | rest: ""}}

      :keep ->
        out = %AudioBuffer{format: state.format, data: rest}
        {[{:out, time, out}], %{state | rest: "", last: time}}

      :pad ->
        frame = AudioFormat.bytes_per_frame(state.format)
        silence = AudioBuffer.silence(state.format, div(state.size - byte_size(rest), frame))
        out = %AudioBuffer{format: state.format, data: rest <> silence.data}
        {[{:out, time, out}], %{state | rest: "", last: time}}
    end
  end

  defp span(format, bytes),
    do: AudioFormat.frames_to_ns(format, div(bytes, AudioFormat.bytes_per_frame(format)))

  defp later(time, nil), do: time
  defp later(time, last), do: max(time, last + 1)
end
