defmodule Situ.Studio.AudioSamples do
  @moduledoc false
  # Reads an interval of an audio stream as 32-bit float samples of one or all channels. Samples
  # are positioned by their timestamps; gaps become silence.
  alias Situ.{AudioBuffer, AudioFormat, Error, AudioOps}
  alias Situ.Studio.StreamReader

  @max_span 10_000_000_000
  @buffers 20_000

  @doc "Returns start time, rate and samples between `from` and `to` (at most 10 s); channel 0 is the first."
  @spec channel_samples(
          Situ.Recording.t(),
          String.t(),
          Situ.Time.t(),
          Situ.Time.t(),
          non_neg_integer()
        ) ::
          {:ok, {Situ.Time.t(), pos_integer(), binary()}} | {:error, Error.t()}
  def channel_samples(source, stream, from, to, channel) do
    with {:ok, {start, rate, _, samples}} <- read_samples(source, stream, {from, to}, channel),
         do: {:ok, {start, rate, samples}}
  end

  @doc "Returns start time, rate, number of channels and the interleaved samples of all channels."
  @spec interleaved_samples(Situ.Recording.t(), String.t(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, {Situ.Time.t(), pos_integer(), pos_integer(), binary()}} | {:error, Error.t()}
  def interleaved_samples(source, stream, from, to),
    do: read_samples(source, stream, {from, to}, :all)

  defp read_samples(_, _, {from, to}, _) when to <= from or to - from > @max_span,
    do: {:error, Error.new(:bad_interval, "the interval must be positive and at most 10 s")}

  defp read_samples(source, stream, {from, to}, channel) do
    # A buffer's timestamp is its end, so a buffer that ends after `to` may contain the last samples.
    with {:ok, messages, _} <- StreamReader.read_messages(source, stream, from, to, @buffers) do
      later =
        case StreamReader.next_after(source, stream, to) do
          {:ok, message} -> [message]
          _ -> []
        end

      buffers =
        for %{data: %AudioBuffer{} = b, originating_time: t} <- messages ++ later, do: {b, t}

      {:ok, join_buffers(buffers, from, to, channel)}
    end
  end

  defp join_buffers([], from, _to, _), do: {from, 16_000, 1, ""}

  defp join_buffers([{first, _} | _] = buffers, from, to, channel) do
    %{rate: rate, channels: channels} = first.format
    width = if channel == :all, do: channels, else: 1
    wanted = AudioFormat.ns_to_frames(first.format, to - from)

    {parts, _} =
      buffers
      |> Enum.filter(fn {b, _} -> b.format.rate == rate end)
      |> Enum.reduce({[], 0}, fn {b, time}, {parts, at} ->
        start = AudioFormat.ns_to_frames(b.format, AudioBuffer.start_time(b, time) - from)
        skip = max(at - start, 0)
        gap = max(min(start, wanted) - at, 0)
        n = max(min(AudioBuffer.frame_count(b) - skip, wanted - max(start, at)), 0)
        samples = b |> AudioBuffer.slice_frames(skip, n) |> convert_to_f32(channel, width)
        silence = :binary.copy(<<0.0::little-float-32>>, gap * width)
        {[samples, silence | parts], at + gap + n}
      end)

    {from, rate, width, parts |> Enum.reverse() |> IO.iodata_to_binary()}
  end

  # In a buffer with fewer channels, the last channel replaces the missing ones.
  defp convert_to_f32(buffer, channel, width) do
    last = buffer.format.channels - 1
    taken = if channel == :all, do: 0..(width - 1), else: [channel]
    gains = for one <- taken, do: for(c <- 0..last, do: if(c == min(one, last), do: 1, else: 0))
    AudioOps.remix!(buffer, gains, sample: :f32).data
  end
end
