defmodule Situ.Examples.Demo.Table do
  @moduledoc false
  # The demo's output: a table for people, or one JSON object.

  @spec render(map()) :: iodata()
  def render(%{opts: opts} = result), do: if(opts[:json], do: json(result), else: text(result))

  defp json(%{recording: recording, score: score} = result) do
    score =
      if score, do: score |> Map.from_struct() |> strings(), else: %{"frames" => recording.frames}

    score
    |> Map.merge(%{
      "wall_s" => Float.round(result.wall_s, 3),
      "media_s" => Float.round(recording.media_s * 1.0, 3),
      "latency_p95_ms" => result.opts[:realtime] && round_ms(elem(recording.latency_ms, 1)),
      "sound_late_ms" => div(sync(result).shift, 1_000_000),
      "sound_late_confidence" => sync(result).confidence,
      "sound_moved_ms" => div(result.opts[:sound_shift] || 0, 1_000_000),
      "recording" => result.path
    })
    |> Map.merge(said_json(result.said))
    |> Situ.JSON.encode()
  end

  defp said_json(nil), do: %{}

  defp said_json(%{lines: lines, score: score}) do
    utterances =
      for line <- lines do
        %{
          "face" => line.face,
          "from" => Float.round(line.from / 1.0e9, 3),
          "to" => Float.round(line.to / 1.0e9, 3),
          "text" => line.text
        }
      end

    Map.merge(%{"utterances" => utterances}, strings(score || %{}))
  end

  defp strings(map), do: Map.new(map, fn {key, value} -> {Atom.to_string(key), value} end)

  defp text(%{recording: recording} = result) do
    [
      missing(recording.missing),
      out_of_step(result),
      spoken(recording.spoken),
      said(result.said),
      score(result.score),
      "\n#{recording.frames} pictures, #{seconds(recording.media_s)} s",
      if(result.wall_s > 0, do: ", in #{seconds(result.wall_s)} s", else: []),
      latency(result),
      origin(recording),
      "\nRecording: ",
      result.path
    ]
  end

  # The estimate by which the sound was moved, or that of the recording.
  defp sync(%{opts: opts, recording: recording}), do: opts[:sync] || recording.sync

  defp out_of_step(%{opts: opts} = result) do
    sync = sync(result)
    lateness = if sync.shift > 0, do: "late", else: "early"
    ms = div(abs(sync.shift), 1_000_000)
    message = "The sound is #{ms} ms #{lateness} against the lips (confidence #{sync.confidence})"

    cond do
      opts[:sync] -> [message, ": it was moved by that for the following results.\n"]
      Situ.Infer.LipSync.off?(sync) -> [message, ": do not rely on who speaks.\n"]
      true -> []
    end
  end

  # A file without a creation time begins at the epoch, so the year needs an explanation.
  defp origin(%{start: start, frames: frames}) when frames > 0 and start < 86_400_000_000_000,
    do: "\nThe clip does not say when it was made: its times count from 1970-01-01."

  defp origin(_recording), do: []

  defp missing(list) do
    for what <- list do
      case what do
        :sound -> "There is no sound in this: nobody can be heard speaking.\n"
        :pictures -> "There are no pictures in this: voices only, and nobody to give them to.\n"
      end
    end
  end

  defp said(nil), do: []
  defp said(%{lines: []}), do: "\nNothing was said that could be understood.\n"

  defp said(%{lines: lines, file: file, score: score}) do
    [
      "\n  face   from      to  said\n",
      for line <- lines do
        face = if line.face == nil, do: "-", else: to_string(line.face)
        [String.pad_leading(face, 6), time(line.from), time(line.to), "  ", line.text, "\n"]
      end,
      said_score(score),
      "Transcript: ",
      file,
      "\n"
    ]
  end

  defp said_score(%{wer: wer, right_face: right}) when wer != nil do
    "Words wrong: #{Float.round(wer * 100, 1)} %; at the right face: #{Float.round(right * 100, 1)} %\n"
  end

  defp said_score(_), do: []

  defp spoken([]), do: "Nobody was seen speaking.\n"

  defp spoken(rows) do
    [
      "  face   from      to\n",
      for {id, from, to} <- rows do
        [String.pad_leading(to_string(id), 6), time(from), time(to), "\n"]
      end
    ]
  end

  defp score(nil), do: []

  defp score(score) do
    [
      "\nRight in #{Float.round(score.frame_accuracy * 100, 2)} % ",
      "of #{score.scored_frames} scored pictures of #{score.frames}; ",
      "speech given wrongly #{score.false_speech_s} s, missed #{score.missed_speech_s} s"
    ]
  end

  defp latency(%{opts: opts, recording: %{latency_ms: {median, p95}}}) when median != nil do
    if opts[:realtime] || opts[:live],
      do:
        "\nFrom picture to decision: median #{round_ms(median)} ms, 95 % within #{round_ms(p95)} ms",
      else: "\nReplayed as fast as possible: latencies in the recording are not real time."
  end

  defp latency(_), do: []

  defp round_ms(nil), do: nil
  defp round_ms(ms), do: Float.round(ms * 1.0, 1)

  defp time(ns), do: String.pad_leading(seconds(ns / 1.0e9), 8)
  defp seconds(s), do: :erlang.float_to_binary(s * 1.0, decimals: 2)
end
