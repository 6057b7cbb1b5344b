defmodule Situ.AudioStream.Streamline do
  @moduledoc false
  # The component of `Situ.AudioStream.streamline/2`, which documents its methods.

  @schema [
    method: [
      type: {:in, [:concatenate, :pleat, :unpleat]},
      default: :unpleat,
      doc: "Method, see above."
    ],
    max_offset: [
      type: :time_ns,
      default: 0,
      doc:
        "`:unpleat`: maximum drift of the times from the input's before they are corrected, ns."
    ]
  ]

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.AudioStream.GapSilence

  @impl true
  def init(opts), do: {:ok, %{opts: opts, format: nil, origin: nil, frames: 0, last: nil}}

  @impl true
  def handle_message(:in, %{data: buffer, originating_time: time}, _context, state) do
    state = ensure_format(state, buffer, time)
    fitted = fit_buffer(state.opts[:method], buffer, time, state)
    emit_buffer(fitted, time, state)
  end

  # Counts frames from the start of the first buffer, so that rounding errors do not accumulate.
  defp ensure_format(%{format: nil} = state, buffer, time),
    do: %{state | format: buffer.format, origin: AudioBuffer.start_time(buffer, time)}

  defp ensure_format(%{format: format} = state, %{format: format}, _time), do: state

  defp ensure_format(%{format: format}, buffer, _time) do
    raise Error.new(
            :bad_audio,
            "the audio format changed from #{inspect(format)} to #{inspect(buffer.format)}",
            why: "streamline counts frames in one format",
            fix: "resample or reformat the stream first"
          )
  end

  defp fit_buffer(:concatenate, buffer, _time, _state), do: buffer

  defp fit_buffer(:pleat, buffer, time, state) do
    wanted = AudioFormat.ns_to_frames(buffer.format, time - state.origin) - state.frames
    have = AudioBuffer.frame_count(buffer)

    if wanted <= have,
      do: AudioBuffer.slice_frames(buffer, 0, max(wanted, 0)),
      else: concat_buffers(buffer, GapSilence.build_silence!(buffer.format, wanted - have))
  end

  defp fit_buffer(:unpleat, buffer, time, state) do
    have = AudioBuffer.frame_count(buffer)
    reached = state.origin + AudioFormat.frames_to_ns(buffer.format, state.frames + have)
    drift = time - reached

    cond do
      abs(drift) <= state.opts[:max_offset] ->
        buffer

      drift > 0 ->
        missing = AudioFormat.ns_to_frames(buffer.format, drift)
        concat_buffers(GapSilence.build_silence!(buffer.format, missing), buffer)

      true ->
        AudioBuffer.slice_frames(buffer, AudioFormat.ns_to_frames(buffer.format, -drift), have)
    end
  end

  defp emit_buffer(%AudioBuffer{data: ""}, _time, state), do: {[], state}

  defp emit_buffer(buffer, time, state) do
    frames = state.frames + AudioBuffer.frame_count(buffer)
    runs_on = state.origin + AudioFormat.frames_to_ns(buffer.format, frames)
    at = if state.opts[:method] == :pleat, do: time, else: runs_on
    at = if state.last, do: max(at, state.last + 1), else: at
    {[{:out, at, buffer}], %{state | frames: frames, last: at}}
  end

  defp concat_buffers(a, b), do: %{a | data: a.data <> b.data}
end
