defmodule Situ.Studio.Visualizers.Waveform do
  @moduledoc """
  Sound as the band between its extremes: of all channels together, or of one. One channel is made of the samples, so
  where more than two minutes are asked for all are drawn together, and the frame says so.
  """
  @behaviour Situ.Studio.Visualizer

  alias Situ.{AudioBuffer, Sound}
  alias Situ.Studio.{Frame, Source, Visualizer}
  alias Situ.Studio.Visualizers.Option

  @most 120_000_000_000
  @buffers 20_000

  @impl true
  def about do
    heard = [
      solo: [type: :boolean, title: "Hear this channel only", default: false],
      mute: [type: :boolean, title: "Mute", default: false]
    ]

    options = Option.visible() ++ Option.color() ++ Option.channel() ++ heard

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
    case chosen(spec) do
      nil -> together(source, channel, stream, {from, to, bin}, false)
      _ when to - from > @most -> together(source, channel, stream, {from, to, bin}, true)
      one -> alone(source, channel, {stream, one}, from, to)
    end
  end

  defp chosen(%{props: %{"channel" => text}}) when is_binary(text) do
    case Integer.parse(text) do
      {n, ""} when n >= 1 -> n - 1
      _ -> nil
    end
  end

  defp chosen(_), do: nil

  defp together(source, channel, stream, {from, to, bin}, instead?) do
    with {:ok, points, raw?} <- Source.call(source, :series, [stream, from, to, bin]),
         do: Frame.series(channel, points, raw?, together: instead?)
  end

  defp alone(source, channel, {stream, one}, from, to) do
    with {:ok, messages, _} <- Source.call(source, :messages, [stream, from, to, @buffers]) do
      later = Source.neighbours(source, stream, :after, to, 1)

      points =
        for %{data: %AudioBuffer{} = buffer, originating_time: time} <- messages ++ later,
            one < buffer.format.channels,
            point <- buffer |> taken(one) |> AudioBuffer.points(time),
            do: point

      Frame.series(channel, points, false)
    end
  end

  defp taken(buffer, one) do
    gains = for c <- 0..(buffer.format.channels - 1), do: if(c == one, do: 1, else: 0)
    Sound.remix!(buffer, [gains])
  end
end
