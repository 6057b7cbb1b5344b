defmodule Situ.AudioStream.Reframer do
  @moduledoc false
  # The component of `Situ.AudioStream.reframe/2`, which documents it.

  @schema [
    frames: [type: {:optional, :pos_integer}, default: nil, doc: "Frames in each buffer."],
    duration: [
      type: {:optional, {:integer, 1, 0x7FFFFFFFFFFFFFFF}},
      default: nil,
      doc: "Duration of each buffer, ns, rounded up to complete frames."
    ],
    hop: [
      type: {:optional, :pos_integer},
      default: nil,
      doc:
        "Frames from the start of one buffer to the next; smaller values make buffers overlap. Default: no overlap."
    ],
    tail: [
      type: {:in, [:drop, :keep, :pad]},
      default: :drop,
      doc:
        "Handling of an incomplete buffer at the end: drop it, keep it as a shorter buffer, or " <>
          "pad it with silence."
    ]
  ]

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}

  @impl true
  def init(opts) do
    case {opts[:frames], opts[:duration]} do
      {nil, nil} -> {:error, Error.new(:missing_option, "reframe needs frames: or duration:")}
      {n, nil} when n != nil -> init_state(opts)
      {nil, _} -> init_state(opts)
      _ -> {:error, Error.new(:bad_option, "give frames: or duration:, not both")}
    end
  end

  defp init_state(opts),
    do: {:ok, %{opts: opts, format: nil, size: nil, hop: nil, rest: "", seen: nil, last: nil}}

  @impl true
  def handle_message(:in, %{data: buffer, originating_time: time}, _context, state) do
    {flushed, state} = ensure_format(state, buffer.format)
    data = if state.rest == "", do: buffer.data, else: state.rest <> buffer.data
    {actions, rest, last} = cut_buffers(data, time, state, [])
    # Copies the rest, so that a small remainder does not keep a large buffer alive.
    {flushed ++ actions, %{state | rest: :binary.copy(rest), last: last, seen: time}}
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: flush_tail(state)

  defp ensure_format(%{format: format} = state, format), do: {[], state}

  defp ensure_format(%{opts: opts} = state, format) do
    {actions, state} = flush_tail(state)
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

  defp cut_buffers(data, time, %{size: size, hop: hop} = state, actions)
       when byte_size(data) >= size do
    after_it = byte_size(data) - size
    at = increasing_time(time - bytes_to_ns(state.format, after_it), state.last)
    out = %AudioBuffer{format: state.format, data: binary_part(data, 0, size)}
    skip = min(hop, byte_size(data))
    rest = binary_part(data, skip, byte_size(data) - skip)

    # A hop may be larger than the buffer. It skips only frames that have already arrived.
    cut_buffers(rest, time, %{state | last: at}, [{:out, at, out} | actions])
  end

  defp cut_buffers(data, _time, state, actions), do: {Enum.reverse(actions), data, state.last}

  defp flush_tail(%{rest: ""} = state), do: {[], state}

  defp flush_tail(%{opts: opts, rest: rest} = state) do
    # The padding would end after the input closed, and nothing may be emitted after that time.
    time = increasing_time(state.seen, state.last)

    case opts[:tail] do
      :drop ->
        {[], %{state | rest: ""}}

      :keep ->
        out = %AudioBuffer{format: state.format, data: rest}
        {[{:out, time, out}], %{state | rest: "", last: time}}

      :pad ->
        frame = AudioFormat.bytes_per_frame(state.format)

        silence =
          AudioBuffer.build_silence(state.format, div(state.size - byte_size(rest), frame))

        out = %AudioBuffer{format: state.format, data: rest <> silence.data}
        {[{:out, time, out}], %{state | rest: "", last: time}}
    end
  end

  defp bytes_to_ns(format, bytes),
    do: AudioFormat.frames_to_ns(format, div(bytes, AudioFormat.bytes_per_frame(format)))

  defp increasing_time(time, nil), do: time
  defp increasing_time(time, last), do: max(time, last + 1)
end
