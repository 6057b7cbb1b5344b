defmodule Situ.Annotation.Exchange.Srt do
  @moduledoc false
  # Reads and writes SubRip subtitles. Each annotation is a cue with its track in brackets before
  # the text (`[P1] Hello`). Times are milliseconds from `origin:`. Cues without brackets are put
  # on the track "Cues".
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation.Exchange.Cues

  @impl true
  def encode(layer, opts) do
    {cues, losses} = Cues.build_cues(layer, opts[:origin], "SubRip")

    text =
      for {{from, to, track, text}, n} <- Enum.with_index(cues, 1) do
        # A blank line would end the cue.
        text =
          text |> String.replace(~r/\r\n?/, "\n") |> String.replace(~r/\n(?=\n|\z)/, "\n\u00A0")

        name = String.replace(track, ~r/[\]\s]+/u, " ")

        "#{n}\n#{Cues.format_time(from, ",")} --> #{Cues.format_time(to, ",")}\n[#{name}] #{text}\n\n"
      end

    {text, losses}
  end

  @impl true
  def decode(text, opts) do
    with {:ok, blocks} <- Cues.split_blocks(text) do
      {annotations, bad} =
        Enum.flat_map_reduce(blocks, 0, fn block, bad ->
          with {from, to, text} <- Cues.parse_cue(block),
               {track, text} = split_speaker(String.replace(text, "\u00A0", "")),
               {:ok, annotation} <-
                 Cues.build_annotation({from, to, text}, track, opts[:schema], opts[:origin] || 0) do
            {[annotation], bad}
          else
            _ -> {[], bad + 1}
          end
        end)

      cond do
        annotations == [] and bad > 0 ->
          {:error, "it does not contain a cue with times like 00:00:01,000 --> 00:00:02,500"}

        bad > 0 ->
          {:ok, nil, annotations,
           ["#{bad} cues are damaged or do not fit the schema, and are left out"]}

        true ->
          {:ok, nil, annotations, []}
      end
    end
  end

  defp split_speaker(text) do
    case Regex.run(~r/\A\[([^\]]+)\] ?(.*)\z/s, text) do
      [_, track, rest] -> {track, rest}
      nil -> {"Cues", text}
    end
  end
end
