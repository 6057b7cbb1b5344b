defmodule Situ.Studio.PageExport.Sounds do
  @moduledoc false
  # Collects the sound of an exported page, if it is short: 16-bit samples from the first to the last time, with silence
  # in gaps.
  alias Situ.Studio.{AudioSamples, PageExport}

  # Together, the sounds of a page have at most this many bytes: two minutes at 48 kHz, or six at 16 kHz.
  @most 12_000_000
  @stretch 10_000_000_000

  @doc "Returns a list of the sounds, their samples, and sentences about sounds that are too long."
  @spec collect(PageExport.t(), Situ.Recording.t(), [String.t()]) ::
          {[map()], binary(), [String.t()]}
  def collect(export, source, streams) do
    {sounds, {samples, notes}} =
      Enum.flat_map_reduce(streams, {<<>>, []}, fn stream, {samples, notes} ->
        with {:ok, {rate, channels, size}} <- find_format(export, source, stream),
             true <- byte_size(samples) + size <= @most do
          own = read_samples(export, source, stream, {rate, channels})

          sound = %{
            "stream" => stream,
            "rate" => rate,
            "channels" => channels,
            "at" => Integer.to_string(export.from),
            "offset" => div(byte_size(samples), 2),
            "count" => div(byte_size(own), 2 * channels)
          }

          {[sound], {samples <> own, notes}}
        else
          false -> {[], {samples, ["#{stream}: its sound is too long to be included." | notes]}}
          :none -> {[], {samples, notes}}
        end
      end)

    {sounds, samples, Enum.reverse(notes)}
  end

  # The first stretch with sound gives the format.
  defp find_format(export, source, stream) do
    Enum.find_value(list_stretches(export), :none, fn {a, b} ->
      case AudioSamples.interleaved_samples(source, stream, a, b) do
        {:ok, {_, rate, channels, samples}} when samples != "" ->
          {:ok, {rate, channels, 2 * channels * frames_until(export, rate, export.to)}}

        _ ->
          nil
      end
    end)
  end

  defp read_samples(export, source, stream, {rate, channels}) do
    for {a, b} <- list_stretches(export), reduce: <<>> do
      held ->
        case AudioSamples.interleaved_samples(source, stream, a, b) do
          {:ok, {start, ^rate, ^channels, samples}} when samples != "" ->
            gap = 2 * channels * frames_until(export, rate, start) - byte_size(held)
            held <> :binary.copy(<<0>>, max(gap, 0)) <> to_s16(samples)

          _ ->
            held
        end
    end
  end

  defp frames_until(export, rate, time), do: max(round((time - export.from) * rate / 1.0e9), 0)

  defp list_stretches(%{from: from, to: to}),
    do: for(a <- from..(to - 1)//@stretch, do: {a, min(a + @stretch, to)})

  defp to_s16(samples) do
    for <<x::little-float-32 <- samples>>, into: <<>> do
      <<(x * 32_768) |> round() |> max(-32_768) |> min(32_767)::little-signed-16>>
    end
  end
end
