defmodule Situ.Audio.Mixer do
  @schema [
    gain: [type: :number, default: 1.0, doc: "Factor of the first input."],
    other_gain: [type: :number, default: 1.0, doc: "Factor of the other."]
  ]

  @moduledoc """
  Two sounds as one (`Situ.Audio.mix/3`), laid over each other by their times, sample by sample.

  Both need the same format. A gap in one is silence in the mix; after one has closed the other goes on alone. What
  overlaps (times that go back) is added. Buffers come out as far as both are known.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [in: Situ.AudioBuffer, other: Situ.AudioBuffer],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}

  @impl true
  def init(opts) do
    track = %{waiting: [], known: nil, closed?: false}
    gains = %{in: opts[:gain] * 1.0, other: opts[:other_gain] * 1.0}
    {:ok, %{gains: gains, format: nil, origin: nil, cursor: 0, in: track, other: track}}
  end

  @impl true
  def handle_message(input, %{data: buffer, originating_time: time}, _context, state) do
    state = settle(state, buffer, time)
    first = frame_at(state, AudioBuffer.start_time(buffer, time))
    track = Map.fetch!(state, input)
    stop = first + AudioBuffer.frames(buffer)

    track = %{
      track
      | waiting: track.waiting ++ [{first, buffer}],
        known: max(stop, track.known || stop)
    }

    release(Map.put(state, input, track))
  end

  @impl true
  def handle_closed(input, _time, _context, state) do
    track = %{Map.fetch!(state, input) | closed?: true}
    release(Map.put(state, input, track))
  end

  defp settle(%{format: nil} = state, buffer, time) do
    %{state | format: buffer.format, origin: AudioBuffer.start_time(buffer, time)}
  end

  defp settle(%{format: format} = state, %{format: format}, _time), do: state

  defp settle(%{format: format}, buffer, _time) do
    raise Error.new(:bad_audio, "cannot mix #{inspect(buffer.format)} into #{inspect(format)}",
            fix: "resample and reformat one of them first"
          )
  end

  defp frame_at(state, time), do: AudioFormat.ns_to_frames(state.format, time - state.origin)

  # Emits up to where both tracks are known.
  defp release(state) do
    case ready(state.in, state.other) do
      stop when is_integer(stop) and stop > state.cursor ->
        {[mixed(state, stop)], forget(state, stop)}

      _ ->
        {[], state}
    end
  end

  defp ready(%{closed?: true} = a, %{closed?: true} = b), do: max(a.known || 0, b.known || 0)
  defp ready(%{closed?: true}, b), do: b.known
  defp ready(a, %{closed?: true}), do: a.known
  defp ready(%{known: a}, %{known: b}) when is_integer(a) and is_integer(b), do: min(a, b)
  defp ready(_, _), do: nil

  defp mixed(state, stop) do
    silence = AudioBuffer.silence(state.format, stop - state.cursor)

    sum =
      for input <- [:in, :other],
          {first, buffer} <- Map.fetch!(state, input).waiting,
          reduce: silence do
        sum -> add(sum, buffer, first - state.cursor, state.gains[input])
      end

    {:out, state.origin + AudioFormat.frames_to_ns(state.format, stop), sum}
  end

  defp add(sum, buffer, offset, gain) do
    length = AudioBuffer.frames(sum)
    skip = max(-offset, 0)
    part = AudioBuffer.slice(buffer, skip, max(length - max(offset, 0), 0))
    lead = AudioBuffer.silence(sum.format, min(max(offset, 0), length))
    placed = %{part | data: lead.data <> part.data}
    Situ.Image.Result.unwrap!(AudioBuffer.mix(sum, placed, gain: gain))
  end

  defp forget(state, stop) do
    keep = fn track ->
      waiting =
        Enum.filter(track.waiting, fn {first, b} -> first + AudioBuffer.frames(b) > stop end)

      %{track | waiting: waiting}
    end

    %{state | cursor: stop, in: keep.(state.in), other: keep.(state.other)}
  end
end
