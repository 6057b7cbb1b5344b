defmodule Situ.Examples.Demo.Table do
  @moduledoc false
  # What the demo prints: a table for people, or one JSON object.

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
      "recording" => result.path
    })
    |> Situ.JSON.encode()
  end

  defp strings(map), do: Map.new(map, fn {key, value} -> {Atom.to_string(key), value} end)

  defp text(%{recording: recording} = result) do
    [
      missing(recording.missing),
      spoken(recording.spoken),
      score(result.score),
      "\n#{recording.frames} pictures, #{seconds(recording.media_s)} s",
      if(result.wall_s > 0, do: ", in #{seconds(result.wall_s)} s", else: []),
      latency(result),
      "\nRecording: ",
      result.path
    ]
  end

  defp missing(list) do
    for what <- list do
      case what do
        :sound -> "There is no sound in this: nobody can be heard speaking.\n"
        :pictures -> "There are no pictures in this: voices only, and nobody to give them to.\n"
      end
    end
  end

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
      "\nRight in #{Float.round(score.frame_accuracy * 100, 2)} % of #{score.scored_frames} scored pictures of #{score.frames}; ",
      "speech given wrongly #{score.false_speech_s} s, missed #{score.missed_speech_s} s"
    ]
  end

  defp latency(%{opts: opts, recording: %{latency_ms: {median, p95}}}) when median != nil do
    if opts[:realtime] || opts[:live],
      do:
        "\nFrom picture to decision: median #{round_ms(median)} ms, 95 % within #{round_ms(p95)} ms",
      else: []
  end

  defp latency(_), do: []

  defp round_ms(nil), do: nil
  defp round_ms(ms), do: Float.round(ms * 1.0, 1)

  defp time(ns), do: String.pad_leading(seconds(ns / 1.0e9), 8)
  defp seconds(s), do: :erlang.float_to_binary(s * 1.0, decimals: 2)
end
