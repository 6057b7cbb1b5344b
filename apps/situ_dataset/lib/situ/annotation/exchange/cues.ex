defmodule Situ.Annotation.Exchange.Cues do
  @moduledoc false
  # Contains the common part of WebVTT and SubRip: cues with times in milliseconds, separated by blank lines.
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.LabelRows
  alias Situ.Annotation.{Layer, Schema}

  @ms 1_000_000

  @doc "Returns the cues of a layer, `{from_ms, to_ms, track, text}`, and the losses; points last one millisecond."
  @spec build_cues(Layer.t(), integer(), String.t()) :: {[tuple()], [String.t()]}
  def build_cues(layer, origin, format) do
    annotations = layer |> Layer.annotations() |> Enum.sort_by(&{&1.from, &1.to, &1.track})
    cues = for a <- annotations, do: build_cue(a, layer.schema, origin)
    points = Enum.count(annotations, &(ns_to_ms(&1.from) == ns_to_ms(&1.to)))
    short = if points > 0, do: ["#{format} has no points: #{points} points last 1 ms"], else: []
    before = Enum.count(annotations, &(&1.from < origin))

    early =
      if before > 0,
        do: ["#{format} starts at 0: #{before} annotations before the origin are left out"],
        else: []

    {Enum.reject(cues, &(elem(&1, 0) < 0)),
     LabelRows.describe_losses(annotations, [:fine, :by, :confidence, :note, :proposed?], format) ++
       short ++ early}
  end

  defp build_cue(a, schema, origin) do
    from = ns_to_ms(a.from - origin)
    {from, max(ns_to_ms(a.to - origin), from + 1), a.track, cue_text(a.values, schema)}
  end

  defp ns_to_ms(ns), do: Integer.floor_div(ns + div(@ms, 2), @ms)

  # If there are several attributes, each is written on its own line.
  defp cue_text(values, %{attributes: [attribute]}),
    do: LabelRows.value_to_text(values[attribute.name])

  defp cue_text(values, schema) do
    schema.attributes
    |> Enum.filter(&is_map_key(values, &1.name))
    |> Enum.map_join("\n", &"#{&1.name}: #{LabelRows.value_to_text(values[&1.name])}")
  end

  @doc "Formats a time as `HH:MM:SS`, then `mark` and the milliseconds."
  @spec format_time(non_neg_integer(), String.t()) :: String.t()
  def format_time(ms, mark) do
    pad = fn n, width -> n |> Integer.to_string() |> String.pad_leading(width, "0") end
    seconds = div(ms, 1_000)

    clock = [div(seconds, 3_600), rem(div(seconds, 60), 60), rem(seconds, 60)]
    Enum.map_join(clock, ":", &pad.(&1, 2)) <> mark <> pad.(rem(ms, 1_000), 3)
  end

  @doc "Splits a file into its blocks, which are lists of lines."
  @spec split_blocks(binary()) :: {:ok, [[String.t()]]} | {:error, String.t()}
  def split_blocks(<<0xEF, 0xBB, 0xBF, text::binary>>), do: split_blocks(text)

  def split_blocks(text) do
    if String.valid?(text),
      do:
        {:ok,
         text
         |> String.split(~r/\r\n|\n|\r/)
         |> Enum.chunk_by(&(&1 == ""))
         |> Enum.reject(&match?(["" | _], &1))},
      else: {:error, "it is not UTF-8"}
  end

  @doc "Parses the cue of a block to `{from_ms, to_ms, text}`; returns `nil` if no line contains times."
  @spec parse_cue([String.t()]) :: {integer(), integer(), String.t()} | nil
  def parse_cue(lines) do
    time = ~S"(?:(\d+):)?(\d\d):(\d\d)[.,](\d{3})"
    {_, rest} = Enum.split_while(lines, &(not (&1 =~ "-->")))

    with [line | text] <- rest,
         [_ | parts] <- Regex.run(~r/\A\s*#{time}\s*-->\s*#{time}(?:\s|\z)/, line) do
      {from, to} = Enum.split(parts, 4)
      {parse_milliseconds(from), parse_milliseconds(to), Enum.join(text, "\n")}
    else
      _ -> nil
    end
  end

  defp parse_milliseconds([h, m, s, ms]) do
    [h, m, s, ms] =
      for text <- [h, m, s, ms], do: if(text == "", do: 0, else: String.to_integer(text))

    ((h * 60 + m) * 60 + s) * 1_000 + ms
  end

  @doc "Builds an annotation from a cue."
  @spec build_annotation(
          {integer(), integer(), String.t()},
          String.t(),
          Schema.t() | nil,
          integer()
        ) ::
          {:ok, Annotation.t()} | :error
  def build_annotation({from, to, text}, track, schema, origin) do
    with true <- to >= from, {:ok, values} <- parse_values(text, schema) do
      {:ok,
       %Annotation{from: from * @ms + origin, to: to * @ms + origin, track: track, values: values}}
    else
      _ -> :error
    end
  end

  defp parse_values(text, nil), do: {:ok, %{"Value" => text}}

  defp parse_values(text, %{attributes: [attribute]} = schema) do
    with {:ok, value} <- Schema.parse_value(schema, attribute.name, text),
         do: {:ok, %{attribute.name => value}}
  end

  # A line that does not start with an attribute name continues the value of the line before it.
  defp parse_values(text, schema) do
    names = Enum.map(schema.attributes, & &1.name)

    text
    |> String.split("\n")
    |> Enum.chunk_while([], &collect_value_lines(&1, &2, names), &{:cont, Enum.reverse(&1), []})
    |> Enum.reduce_while({:ok, %{}}, fn lines, {:ok, values} ->
      with [name, value] <- lines |> Enum.join("\n") |> String.split(": ", parts: 2),
           {:ok, value} <- Schema.parse_value(schema, name, value) do
        {:cont, {:ok, Map.put(values, name, value)}}
      else
        _ -> {:halt, :error}
      end
    end)
  end

  defp collect_value_lines(line, lines, names) do
    if lines != [] and Enum.any?(names, &String.starts_with?(line, &1 <> ": ")),
      do: {:cont, Enum.reverse(lines), [line]},
      else: {:cont, [line | lines]}
  end
end
