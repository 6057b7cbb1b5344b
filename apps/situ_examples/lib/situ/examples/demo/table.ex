defmodule Situ.Examples.Demo.Table do
  @moduledoc false
  # Renders the demo's output as a table for people or as one JSON object.

  @spec render(map()) :: iodata()
  def render(%{opts: opts} = result),
    do: if(opts[:json], do: render_json(result), else: render_text(result))

  defp render_json(%{recording: recording, score: score} = result) do
    score =
      if score,
        do: score |> Map.from_struct() |> stringify_keys(),
        else: %{"frames" => recording.frames}

    score
    |> Map.merge(%{
      "wall_s" => Float.round(result.wall_s, 3),
      "media_s" => Float.round(recording.media_s * 1.0, 3),
      "latency_p95_ms" => result.opts[:realtime] && round_ms(elem(recording.latency_ms, 1)),
      "sound_late_ms" => div(audio_sync(result).shift, 1_000_000),
      "sound_late_confidence" => audio_sync(result).confidence,
      "sound_moved_ms" => div(result.opts[:sound_shift] || 0, 1_000_000),
      "recording" => result.path
    })
    |> Map.merge(transcript_fields(result.said))
    |> Situ.JSON.encode()
  end

  defp transcript_fields(nil), do: %{}

  defp transcript_fields(%{lines: lines, score: score}) do
    utterances =
      for line <- lines do
        %{
          "face" => line.face,
          "from" => Float.round(line.from / 1.0e9, 3),
          "to" => Float.round(line.to / 1.0e9, 3),
          "text" => line.text
        }
      end

    Map.merge(%{"utterances" => utterances}, stringify_keys(score || %{}))
  end

  defp stringify_keys(map), do: Map.new(map, fn {key, value} -> {Atom.to_string(key), value} end)

  defp render_text(%{recording: recording} = result) do
    [
      render_missing(recording.missing),
      render_sync_note(result),
      render_intervals(recording.spoken),
      render_transcript(result.said),
      render_score(result.score),
      "\n#{recording.frames} images, #{format_seconds(recording.media_s)} s",
      if(result.wall_s > 0, do: ", in #{format_seconds(result.wall_s)} s", else: []),
      render_latency(result),
      render_origin_note(recording),
      "\nRecording: ",
      result.path
    ]
  end

  # Prefers the estimate that was used to shift the audio; the recording contains the estimate after that shift.
  defp audio_sync(%{opts: opts, recording: recording}), do: opts[:sync] || recording.sync

  defp render_sync_note(%{opts: opts} = result) do
    sync = audio_sync(result)
    lateness = if sync.shift > 0, do: "late", else: "early"
    ms = div(abs(sync.shift), 1_000_000)

    message =
      "The audio is #{ms} ms #{lateness} relative to the lips (confidence #{sync.confidence})"

    cond do
      opts[:sync] ->
        [message, "; it was shifted by that amount for the following results.\n"]

      Situ.Infer.LipSync.out_of_sync?(sync) ->
        [message, "; the detected speakers are unreliable.\n"]

      true ->
        []
    end
  end

  # A file without a creation time starts at the epoch, so the year needs an explanation.
  defp render_origin_note(%{start: start, frames: frames})
       when frames > 0 and start < 86_400_000_000_000,
       do: "\nThe clip has no creation time, so its times start at 1970-01-01."

  defp render_origin_note(_recording), do: []

  defp render_missing(list) do
    for what <- list do
      case what do
        :sound -> "The recording has no audio, so no speech can be detected.\n"
        :pictures -> "The recording has no video, so speech cannot be attributed to faces.\n"
      end
    end
  end

  defp render_transcript(nil), do: []
  defp render_transcript(%{lines: []}), do: "\nNo speech was recognized.\n"

  defp render_transcript(%{lines: lines, file: file, score: score}) do
    [
      "\n  face   from      to  said\n",
      for line <- lines do
        face = if line.face == nil, do: "-", else: to_string(line.face)

        [
          String.pad_leading(face, 6),
          format_time(line.from),
          format_time(line.to),
          "  ",
          line.text,
          "\n"
        ]
      end,
      render_transcript_score(score),
      "Transcript: ",
      file,
      "\n"
    ]
  end

  defp render_transcript_score(%{wer: wer, right_face: right}) when wer != nil do
    "Word error rate: #{Float.round(wer * 100, 1)} %; correct face: #{Float.round(right * 100, 1)} %\n"
  end

  defp render_transcript_score(_), do: []

  defp render_intervals([]), do: "Nobody was seen speaking.\n"

  defp render_intervals(rows) do
    [
      "  face   from      to\n",
      for {id, from, to} <- rows do
        [String.pad_leading(to_string(id), 6), format_time(from), format_time(to), "\n"]
      end
    ]
  end

  defp render_score(nil), do: []

  defp render_score(score) do
    [
      "\n#{Float.round(score.frame_accuracy * 100, 2)} % correct ",
      "in #{score.scored_frames} scored images of #{score.frames}; ",
      "false speech #{score.false_speech_s} s, missed speech #{score.missed_speech_s} s"
    ]
  end

  defp render_latency(%{opts: opts, recording: %{latency_ms: {median, p95}}})
       when median != nil do
    if opts[:realtime] || opts[:live],
      do:
        "\nLatency from image to decision: median #{round_ms(median)} ms, 95 % within #{round_ms(p95)} ms",
      else: "\nReplayed as fast as possible: latencies in the recording are not real time."
  end

  defp render_latency(_), do: []

  defp round_ms(nil), do: nil
  defp round_ms(ms), do: Float.round(ms * 1.0, 1)

  defp format_time(ns), do: String.pad_leading(format_seconds(ns / 1.0e9), 8)
  defp format_seconds(s), do: :erlang.float_to_binary(s * 1.0, decimals: 2)
end
