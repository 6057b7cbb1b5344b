defmodule Situ.AudioStream.Mixer do
  @moduledoc false
  # The component of `Situ.AudioStream.mix/3`, which documents it.

  @schema [
    gain: [type: :number, default: 1.0, doc: "Factor of the first input."],
    other_gain: [type: :number, default: 1.0, doc: "Factor of the second input."]
  ]

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer, other: Situ.AudioBuffer],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error, AudioOps}
  alias Situ.AudioStream.GapSilence

  @impl true
  def init(opts) do
    # `waiting` holds the newest first.
    track = %{waiting: [], known: nil, closed?: false}
    gains = %{in: opts[:gain] * 1.0, other: opts[:other_gain] * 1.0}
    {:ok, %{gains: gains, format: nil, origin: nil, cursor: nil, in: track, other: track}}
  end

  @impl true
  def handle_message(input, %{data: buffer, originating_time: time}, _context, state) do
    state = ensure_format(state, buffer, time)
    first = frame_at(state, AudioBuffer.start_time(buffer, time))
    track = state |> Map.fetch!(input) |> append_buffer(first, buffer)
    emit_ready_frames(Map.put(state, input, track))
  end

  @impl true
  def handle_closed(input, _time, _context, state) do
    track = %{Map.fetch!(state, input) | closed?: true}
    emit_ready_frames(Map.put(state, input, track))
  end

  defp ensure_format(%{format: nil} = state, buffer, time) do
    %{state | format: buffer.format, origin: AudioBuffer.start_time(buffer, time)}
  end

  defp ensure_format(%{format: format} = state, %{format: format}, _time), do: state

  defp ensure_format(%{format: format}, buffer, _time) do
    raise Error.new(:bad_audio, "cannot mix #{inspect(buffer.format)} into #{inspect(format)}",
            fix: "resample or reformat an input first"
          )
  end

  # Only the frames after the current end of the track are new.
  defp append_buffer(track, first, buffer) do
    count = AudioBuffer.frame_count(buffer)
    from = max(first, track.known || first)
    part = AudioBuffer.slice_frames(buffer, from - first, count)
    waiting = if part.data == "", do: track.waiting, else: [{from, part} | track.waiting]
    %{track | waiting: waiting, known: max(first + count, from)}
  end

  defp frame_at(state, time), do: AudioFormat.ns_to_frames(state.format, time - state.origin)

  # Emits the mix up to the frame that both tracks have reached.
  defp emit_ready_frames(state) do
    stop = ready_until(state.in, state.other)
    state = %{state | cursor: state.cursor || (stop && first_waiting_frame(state))}

    if is_integer(stop) and stop > state.cursor,
      do: {[mix_tracks(state, stop)], drop_emitted(state, stop)},
      else: {[], state}
  end

  # The input whose buffer arrives first is not always the input that begins first.
  defp first_waiting_frame(state) do
    firsts = for input <- [:in, :other], {first, _} <- state[input].waiting, do: first
    Enum.min(firsts, fn -> 0 end)
  end

  defp ready_until(%{closed?: true} = a, %{closed?: true} = b),
    do: max(a.known || 0, b.known || 0)

  defp ready_until(%{closed?: true}, b), do: b.known
  defp ready_until(a, %{closed?: true}), do: a.known
  defp ready_until(%{known: a}, %{known: b}) when is_integer(a) and is_integer(b), do: min(a, b)
  defp ready_until(_, _), do: nil

  defp mix_tracks(state, stop) do
    GapSilence.check_length!(state.format, stop - state.cursor)
    silence = AudioBuffer.build_silence(state.format, stop - state.cursor)

    sum =
      for input <- [:in, :other], reduce: silence do
        sum ->
          part = track_samples(state[input].waiting, state.cursor, stop, state.format)
          Error.unwrap!(AudioOps.mix(sum, part, gain: state.gains[input]))
      end

    {:out, state.origin + AudioFormat.frames_to_ns(state.format, stop), sum}
  end

  # Returns the samples of a track from `cursor` to `stop`, with silence in its gaps.
  defp track_samples(waiting, cursor, stop, format) do
    {data, _end} =
      waiting
      |> Enum.reverse()
      |> Enum.map_reduce(cursor, fn {first, buffer}, at ->
        from = max(first, cursor)
        to = min(first + AudioBuffer.frame_count(buffer), stop)
        part = AudioBuffer.slice_frames(buffer, from - first, max(to - from, 0))
        gap = if part.data == "", do: 0, else: from - at
        {[AudioBuffer.build_silence(format, gap).data, part.data], max(at, to)}
      end)

    %AudioBuffer{format: format, data: IO.iodata_to_binary(data)}
  end

  defp drop_emitted(state, stop) do
    keep = fn track ->
      waiting =
        Enum.filter(track.waiting, fn {first, b} -> first + AudioBuffer.frame_count(b) > stop end)

      %{track | waiting: waiting}
    end

    %{state | cursor: stop, in: keep.(state.in), other: keep.(state.other)}
  end
end
