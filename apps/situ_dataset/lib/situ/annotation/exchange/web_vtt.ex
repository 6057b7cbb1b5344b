defmodule Situ.Annotation.Exchange.WebVtt do
  @moduledoc false
  # Reads and writes WebVTT. Each annotation is a cue, with its track as the cue's voice (`<v
  # TRACK>`). Times are milliseconds from `origin:`.
  #
  # Several attributes are written as lines `ATTRIBUTE: VALUE`. Reading removes the tags from the
  # text. Cues without a voice are put on the track "Cues".
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation.Exchange.Cues

  @impl true
  def encode(layer, opts) do
    {cues, losses} = Cues.build_cues(layer, opts[:origin], "WebVTT")

    text =
      for {{from, to, track, text}, n} <- Enum.with_index(cues, 1) do
        # A blank line would end the cue.
        text = text |> escape() |> String.replace(~r/\n(?=\n|\z)/, "\n&nbsp;")

        "\n#{n}\n#{Cues.format_time(from, ".")} --> #{Cues.format_time(to, ".")}\n<v #{voice_name(track)}>#{text}</v>\n"
      end

    {["WEBVTT\n", text], losses}
  end

  defp escape(text) do
    text
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace(~r/\r\n?/, "\n")
  end

  defp voice_name(track), do: track |> escape() |> String.replace(~r/\s+/u, " ")

  @impl true
  def decode(text, opts) do
    case Cues.split_blocks(text) do
      {:ok, [["WEBVTT" <> rest | _] | blocks]}
      when rest == "" or binary_part(rest, 0, 1) in [" ", "\t"] ->
        decode_cues(blocks, opts)

      {:ok, _} ->
        {:error, "it does not start with WEBVTT"}

      {:error, why} ->
        {:error, why}
    end
  end

  defp decode_cues(blocks, opts) do
    cues = for block <- blocks, cue = Cues.parse_cue(block), do: cue

    notes =
      Enum.count(
        blocks,
        &(Cues.parse_cue(&1) == nil and not (hd(&1) =~ ~r/\A(NOTE|STYLE|REGION)\b/))
      )

    {annotations, bad} =
      Enum.flat_map_reduce(cues, notes, fn {from, to, text}, bad ->
        {track, text} = split_voice(text)

        case Cues.build_annotation({from, to, text}, track, opts[:schema], opts[:origin] || 0) do
          {:ok, annotation} -> {[annotation], bad}
          :error -> {[], bad + 1}
        end
      end)

    losses =
      if bad > 0,
        do: ["#{bad} cues are damaged or do not fit the schema, and are left out"],
        else: []

    {:ok, nil, annotations, losses}
  end

  defp split_voice(text) do
    case Regex.run(~r/\A<v(?:\.[^\s>]*)?[ \t]+([^>]+)>(.*)\z/s, text) do
      [_, track, rest] -> {strip_tags(track), strip_tags(rest)}
      nil -> {"Cues", strip_tags(text)}
    end
  end

  defp strip_tags(text) do
    text
    |> String.replace(~r/<[^>]*>/, "")
    |> String.replace("&nbsp;", "")
    |> String.replace("&lt;", "<")
    |> String.replace("&gt;", ">")
    |> String.replace("&amp;", "&")
  end
end
