defmodule Situ.Studio.Visualizers.Waveform do
  @moduledoc false
  # Draws audio as the band between its extremes, for all channels together or for one channel. A
  # single channel is computed from the samples. A window of more than two minutes therefore shows
  # all channels together, and the frame marks this.
  @behaviour Situ.Studio.Visualizer

  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  alias Situ.Studio.{Draw.Values, Frame, Visualizer, StreamOverview, StreamReader}
  alias Situ.Studio.Visualizers.SharedOptions

  @most 120_000_000_000
  @buffers 20_000

  @impl true
  def about do
    heard = [
      solo: [type: :boolean, title: "Play this channel only", default: false],
      mute: [type: :boolean, title: "Mute", default: false]
    ]

    options = SharedOptions.visible() ++ SharedOptions.color() ++ SharedOptions.channel() ++ heard

    %Visualizer{
      id: "waveform",
      title: "Waveform",
      panel: :plot,
      shapes: [:audio],
      options: options,
      asks: [:channel]
    }
  end

  @impl true
  def window(source, channel, %{stream: stream} = spec, from, to, bin) do
    case selected_channel(spec) do
      nil ->
        all_channels_frame(source, channel, stream, {from, to, bin}, false)

      _ when to - from > @most ->
        all_channels_frame(source, channel, stream, {from, to, bin}, true)

      one ->
        channel_frame(source, channel, {stream, one}, from, to)
    end
  end

  defp selected_channel(%{props: %{"channel" => text}}) when is_binary(text) do
    case Integer.parse(text) do
      {n, ""} when n >= 1 -> n - 1
      _ -> nil
    end
  end

  defp selected_channel(_), do: nil

  defp all_channels_frame(source, channel, stream, {from, to, bin}, instead?) do
    with {:ok, points, raw?} <- StreamOverview.read_series(source, stream, from, to, bin),
         do: Frame.series(channel, points, raw?, together: instead?)
  end

  defp channel_frame(source, channel, {stream, one}, from, to) do
    with {:ok, messages, _} <- StreamReader.read_messages(source, stream, from, to, @buffers) do
      later = StreamReader.list_neighbours(source, stream, :after, to, 1)

      points =
        for %{data: %AudioBuffer{} = buffer, originating_time: time} <- messages ++ later,
            one < buffer.format.channels,
            point <- buffer |> extract_channel(one) |> AudioBuffer.points(time),
            do: point

      Frame.series(channel, points, false)
    end
  end

  defp extract_channel(buffer, one) do
    gains = for c <- 0..(buffer.format.channels - 1), do: if(c == one, do: 1, else: 0)
    AudioOps.remix!(buffer, [gains])
  end

  @impl true
  def value_at(source, channel, %{stream: stream} = spec, time) do
    with {:ok, %{data: %AudioBuffer{} = buffer} = message} <- fetch_sounding(source, stream, time) do
      start = AudioBuffer.start_time(buffer, message.originating_time)
      frames = AudioBuffer.frame_count(buffer)
      n = time |> frame_at(start, buffer.format) |> min(frames - 1)
      at = start + AudioFormat.frames_to_ns(buffer.format, n)

      {:ok, {at, message.sequence_id},
       Values.values_frame(channel, at, named_samples(buffer, n, selected_channel(spec)))}
    else
      {:ok, _no_sound} -> :none
      other -> other
    end
  end

  # A buffer's time is its end, so the first buffer that ends after the cursor is heard at the cursor if it has already
  # begun. In a gap the value is the last sample of the previous buffer, and the page shows its age.
  defp fetch_sounding(source, stream, time) do
    case StreamReader.next_after(source, stream, time) do
      {:ok, %{data: %AudioBuffer{} = buffer, originating_time: stop} = message} ->
        if AudioBuffer.frame_count(buffer) > 0 and AudioBuffer.start_time(buffer, stop) <= time,
          do: {:ok, message},
          else: fetch_before(source, stream, time)

      _none ->
        fetch_before(source, stream, time)
    end
  end

  defp fetch_before(source, stream, time) do
    with {:ok, %{data: %AudioBuffer{} = buffer} = message} <-
           StreamReader.latest_at(source, stream, time),
         do: if(AudioBuffer.frame_count(buffer) > 0, do: {:ok, message}, else: :none)
  end

  # Returns the last frame that begins at or before a time. Frames begin at fractions of a ns, which are rounded.
  defp frame_at(time, start, format) do
    n = max(AudioFormat.ns_to_frames(format, time - start), 0)

    if n > 0 and start + AudioFormat.frames_to_ns(format, n) > time, do: n - 1, else: n
  end

  defp named_samples(buffer, n, one) do
    channels = if one, do: [one], else: Enum.to_list(0..(buffer.format.channels - 1))
    one_frame = AudioBuffer.slice_frames(buffer, n, 1)

    for c <- channels, c < buffer.format.channels do
      name = if match?([_], channels), do: "", else: Integer.to_string(c + 1)
      {name, sample_value(extract_channel(one_frame, c))}
    end
  end

  defp sample_value(frame) do
    case AudioOps.remix!(frame, [[1]], sample: :f32).data do
      <<value::little-float-32>> -> value
      _not_a_number -> nil
    end
  end
end
