defmodule Situ.Studio.Visualizers.Spectrogram do
  @moduledoc false
  # Draws the frequencies of audio over time. The page receives a short segment of audio for each
  # of several hundred positions in the window and transforms them in a worker. When the view is
  # zoomed out, the segments are samples of the audio.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, AudioSamples, Visualizer, StreamReader}
  alias Situ.Studio.Visualizers.SharedOptions

  @samples 512
  @silence :binary.copy(<<0>>, @samples * 4)
  @columns 500
  @second 1_000_000_000

  @impl true
  def about do
    %Visualizer{
      id: "spectrogram",
      title: "Spectrogram",
      panel: :plot,
      shapes: [:audio],
      options: SharedOptions.visible() ++ SharedOptions.channel(),
      asks: [:channel]
    }
  end

  @impl true
  def window(source, channel, %{stream: stream} = spec, from, to, _bin) do
    one = selected_channel(spec)

    with {:ok, rate} <- sample_rate(source, stream, from) do
      length = div(@samples * @second, rate) + 1
      step = max(div(to - from, @columns), length)
      # Positions are multiples of the step, so that a view that moves has the same segments.
      first = Integer.floor_div(from, step) * step

      pieces =
        for t <- first..to//step,
            piece = read_segment(source, {stream, one}, t, length),
            do: {t, piece}

      Frame.audio_chunks(channel, pieces, rate)
    end
  end

  # Returns `nil` if there is not enough audio, or only silence.
  defp read_segment(source, {stream, channel}, time, length) do
    case AudioSamples.channel_samples(source, stream, time, time + length, channel) do
      {:ok, {_, _, <<@silence, _::binary>>}} -> nil
      {:ok, {_, _, <<samples::binary-size(@samples * 4), _::binary>>}} -> samples
      _ -> nil
    end
  end

  # If all channels are chosen, the first one is shown.
  defp selected_channel(%{props: %{"channel" => <<digit>>}}) when digit in ?1..?8, do: digit - ?1
  defp selected_channel(_), do: 0

  defp sample_rate(source, stream, time) do
    with :none <- StreamReader.next_after(source, stream, time),
         :none <- StreamReader.latest_at(source, stream, time) do
      {:ok, 16_000}
    else
      {:ok, %{data: %Situ.AudioBuffer{format: format}}} -> {:ok, format.rate}
      {:ok, _} -> {:error, Situ.Error.new(:no_sound, "these messages do not contain audio")}
      {:error, error} -> {:error, error}
    end
  end

  @impl true
  def value_at(source, channel, %{stream: stream} = spec, time) do
    with {:ok, rate} <- sample_rate(source, stream, time) do
      length = div(@samples * @second, rate) + 1

      case read_segment(source, {stream, selected_channel(spec)}, time, length) do
        nil -> :none
        samples -> {:ok, time, Frame.audio_chunks(channel, [{time, samples}], rate)}
      end
    end
  end
end
