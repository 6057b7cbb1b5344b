defmodule Situ.Media.Capture.Arguments do
  @moduledoc false
  # Builds the arguments of ffmpeg that select, filter and encode the streams of a capture.
  alias Situ.Media.Capture.Clock
  alias Situ.Media.Decoder

  @doc "Returns the arguments that follow the input. `outputs` and `opts` are those of the capture."
  @spec build_output_args(%{atom() => atom()}, :start | :arrival | :wall, keyword()) :: [
          String.t()
        ]
  def build_output_args(outputs, clock, opts),
    do: map_args(outputs) ++ video_args(outputs, clock, opts) ++ audio_args(outputs, clock, opts)

  defp map_args(outputs) do
    Enum.flat_map([video: "0:v:0?", audio: "0:a:0?"], fn {kind, spec} ->
      if Map.has_key?(outputs, kind), do: ["-map", spec], else: []
    end)
  end

  defp video_args(%{video: _}, clock, opts) do
    scale =
      if opts[:size], do: ["scale=#{elem(opts[:size], 0)}:#{elem(opts[:size], 1)}"], else: []

    filters = mark_filter(clock, "setpts=") ++ rate_filter(clock, opts[:rate]) ++ scale

    if(filters == [], do: [], else: ["-vf", Enum.join(filters, ",")]) ++
      Decoder.raw_video(opts[:format], nil)
  end

  defp video_args(_outputs, _clock, _opts), do: []

  defp audio_args(%{audio: _}, clock, opts) do
    marks = mark_filter(clock, "asetpts=")

    case opts[:audio_format] do
      nil -> ~w(-c:a pcm_s16le) ++ Enum.flat_map(marks, &["-af", &1])
      format -> Decoder.raw_audio(format, opts[:audio_buffer], marks)
    end
  end

  defp audio_args(_outputs, _clock, _opts), do: []

  defp mark_filter(:arrival, filter), do: [filter <> Clock.mark_jumps()]
  defp mark_filter(_clock, _filter), do: []

  # The driver sets the rate of a camera, and other streams are thinned out here. The filter `fps` would fill each jump
  # of the sender's clock with copies of the last image.
  defp rate_filter(_clock, nil), do: []
  defp rate_filter(:wall, _rate), do: []
  defp rate_filter(:start, rate), do: ["fps=#{rate}"]

  defp rate_filter(:arrival, rate),
    do: ["select='isnan(prev_t)+gt(floor(t*#{rate}),floor(prev_t*#{rate}))'"]
end
