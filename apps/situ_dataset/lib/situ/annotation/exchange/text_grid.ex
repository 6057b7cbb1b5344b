defmodule Situ.Annotation.Exchange.TextGrid do
  @moduledoc false
  # Writes Praat's TextGrid files in the long text form, and reads the long and the short form in
  # UTF-8 or UTF-16.
  #
  # Each track (or track and attribute) is a tier. Praat requires intervals with an empty label
  # between annotations, so an annotation with an empty label is lost. Points of a track are in a
  # point tier `TRACK (points)`. Times are seconds from `origin:`, exact to the nanosecond.
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation.Exchange.LabelRows
  alias Situ.Annotation.Layer

  @s 1_000_000_000

  @impl true
  def encode(layer, opts) do
    annotations = Layer.annotations(layer)
    last = annotations |> Enum.map(& &1.to) |> Enum.max(fn -> opts[:origin] end)

    first =
      annotations
      |> Enum.map(& &1.from)
      |> Enum.min(fn -> opts[:origin] end)
      |> min(opts[:origin])

    # Praat does not accept a time span of length zero.
    span = {first, max(last, first + 1)}
    tiers = Enum.flat_map(LabelRows.layer_rows(layer), &row_tiers/1)

    text = [
      ~s(File type = "ooTextFile"\nObject class = "TextGrid"\n\n),
      "xmin = #{format_seconds(first, opts)} \nxmax = #{format_seconds(elem(span, 1), opts)} \n",
      "tiers? <exists> \nsize = #{length(tiers)} \nitem []: \n",
      tiers |> Enum.with_index(1) |> Enum.map(&encode_tier(&1, span, opts))
    ]

    empty = for {_, _, labels} <- LabelRows.layer_rows(layer), {_, ""} <- labels, do: 1

    losses =
      LabelRows.describe_losses(annotations, [:by, :confidence, :note, :proposed?], "Praat")

    {text, losses ++ describe_empty_labels(length(empty)) ++ describe_points(annotations)}
  end

  defp describe_empty_labels(0), do: []

  defp describe_empty_labels(n),
    do: ["Praat does not treat an empty label as an annotation: #{n} are lost"]

  defp describe_points(annotations) do
    case Enum.count(annotations, &(&1.from == &1.to)) do
      0 -> []
      n -> ["Praat stores points in separate tiers: #{n} are on tiers called \"... (points)\""]
    end
  end

  defp row_tiers({_, name, labels}) do
    {points, intervals} = Enum.split_with(labels, fn {a, _} -> a.from == a.to end)

    if(intervals != [], do: [{:intervals, name, intervals}], else: []) ++
      if(points != [], do: [{:points, name <> " (points)", points}], else: [])
  end

  defp encode_tier({{:intervals, name, labels}, n}, {first, last} = span, opts) do
    filled = fill_gaps(labels, first, last)

    [
      encode_tier_head(n, "IntervalTier", name, span, opts),
      "        intervals: size = #{length(filled)} \n",
      for {{from, to, text}, i} <- Enum.with_index(filled, 1) do
        """
                intervals [#{i}]:
                    xmin = #{format_seconds(from, opts)}
                    xmax = #{format_seconds(to, opts)}
                    text = #{quote_text(text)}
        """
      end
    ]
  end

  defp encode_tier({{:points, name, labels}, n}, span, opts) do
    [
      encode_tier_head(n, "TextTier", name, span, opts),
      "        points: size = #{length(labels)} \n",
      for {{a, text}, i} <- Enum.with_index(labels, 1) do
        "        points [#{i}]:\n            number = #{format_seconds(a.from, opts)} \n" <>
          "            mark = #{quote_text(text)} \n"
      end
    ]
  end

  defp encode_tier_head(n, class, name, {first, last}, opts) do
    """
        item [#{n}]:
            class = "#{class}"
            name = #{quote_text(name)}
            xmin = #{format_seconds(first, opts)}
            xmax = #{format_seconds(last, opts)}
    """
  end

  defp fill_gaps(labels, first, last) do
    {filled, at} =
      Enum.flat_map_reduce(labels, first, fn {a, text}, at ->
        gap = if a.from > at, do: [{at, a.from, ""}], else: []
        {gap ++ [{a.from, a.to, text}], a.to}
      end)

    if at < last, do: filled ++ [{at, last, ""}], else: filled
  end

  # Nanoseconds are written exactly, without a conversion to floats.
  defp format_seconds(time, opts) do
    ns = time - opts[:origin]
    sign = if ns < 0, do: "-", else: ""

    fraction =
      ns
      |> abs()
      |> rem(@s)
      |> Integer.to_string()
      |> String.pad_leading(9, "0")
      |> String.trim_trailing("0")

    sign <>
      Integer.to_string(div(abs(ns), @s)) <> if(fraction == "", do: "", else: "." <> fraction)
  end

  defp quote_text(text), do: ~s("#{String.replace(text, "\"", "\"\"")}")

  @impl true
  def decode(text, opts) do
    with {:ok, text} <- convert_to_utf8(text),
         {:ok, rows} <- text |> scan_tokens([]) |> parse_grid(opts[:origin] || 0) do
      {annotations, losses} = LabelRows.rows_to_annotations(rows, opts[:schema])
      {:ok, nil, annotations, losses}
    end
  end

  defp convert_to_utf8(<<0xFE, 0xFF, text::binary>>), do: utf16_to_utf8(text, :big)
  defp convert_to_utf8(<<0xFF, 0xFE, text::binary>>), do: utf16_to_utf8(text, :little)
  defp convert_to_utf8(<<0xEF, 0xBB, 0xBF, text::binary>>), do: convert_to_utf8(text)

  # Old versions of Praat wrote Latin-1.
  defp convert_to_utf8(text),
    do:
      {:ok, if(String.valid?(text), do: text, else: :unicode.characters_to_binary(text, :latin1))}

  defp utf16_to_utf8(text, endian) do
    case :unicode.characters_to_binary(text, {:utf16, endian}) do
      text when is_binary(text) -> {:ok, text}
      _ -> {:error, "it is neither UTF-8 nor UTF-16"}
    end
  end

  # Both forms contain the same sequence of quoted texts, numbers and flags; other words are only for human readers.
  defp scan_tokens("", done), do: Enum.reverse(done)

  defp scan_tokens("\"" <> text, done) do
    case quoted_text(text, "") do
      {:ok, value, rest} -> scan_tokens(rest, [{:text, value} | done])
      :error -> [:cut | done] |> Enum.reverse()
    end
  end

  defp scan_tokens("<exists>" <> rest, done), do: scan_tokens(rest, [:exists | done])

  defp scan_tokens("!" <> rest, done),
    do: rest |> String.split("\n", parts: 2) |> Enum.at(1, "") |> scan_tokens(done)

  # Item numbers in brackets are also only for human readers.
  defp scan_tokens("[" <> rest, done),
    do: rest |> String.split("]", parts: 2) |> Enum.at(1, "") |> scan_tokens(done)

  defp scan_tokens(<<c, _::binary>> = text, done) when c in ?0..?9 or c == ?- do
    [number] = Regex.run(~r/\A-?\d*(?:\.\d+)?(?:[eE][-+]?\d+)?/, text)

    rest =
      binary_part(text, max(byte_size(number), 1), byte_size(text) - max(byte_size(number), 1))

    scan_tokens(rest, if(number in ["", "-"], do: done, else: [{:number, number} | done]))
  end

  # Skips a complete word, because a digit in it is not a number.
  defp scan_tokens(<<c::utf8, _::binary>> = text, done) when c in ?a..?z or c in ?A..?Z do
    [word] = Regex.run(~r/\A\w+/u, text)
    scan_tokens(binary_part(text, byte_size(word), byte_size(text) - byte_size(word)), done)
  end

  defp scan_tokens(<<_::utf8, rest::binary>>, done), do: scan_tokens(rest, done)
  defp scan_tokens(_, done), do: Enum.reverse([:cut | done])

  defp quoted_text(text, value) do
    case String.split(text, "\"", parts: 2) do
      [part, "\"" <> rest] -> quoted_text(rest, value <> part <> "\"")
      [part, rest] -> {:ok, value <> part, rest}
      [_] -> :error
    end
  end

  defp parse_grid(
         [{:text, "ooTextFile" <> _}, {:text, "TextGrid"}, {:number, _}, {:number, _} | rest],
         origin
       ) do
    case rest do
      [:exists, {:number, _} | tiers] -> parse_tiers(tiers, origin, [])
      _ -> {:ok, []}
    end
  end

  defp parse_grid(_, _origin), do: {:error, "it does not start like a TextGrid file"}

  defp parse_tiers([], _origin, rows), do: {:ok, Enum.reverse(rows)}

  defp parse_tiers(
         [{:text, class}, {:text, name}, {:number, _}, {:number, _}, {:number, n} | rest],
         origin,
         rows
       )
       when class in ["IntervalTier", "TextTier"] do
    with {size, ""} when size <= 10_000_000 <- Integer.parse(n),
         {:ok, labels, rest} <- parse_labels(class, rest, size, origin, []) do
      parse_tiers(rest, origin, [{name, Enum.reject(labels, &(elem(&1, 2) == ""))} | rows])
    else
      _ -> {:error, "the tier #{inspect(name)} is truncated or has invalid numbers"}
    end
  end

  defp parse_tiers(_, _origin, rows), do: {:error, "it is damaged after #{length(rows)} tiers"}

  defp parse_labels(_class, rest, 0, _origin, done), do: {:ok, Enum.reverse(done), rest}

  defp parse_labels(
         "IntervalTier",
         [{:number, a}, {:number, b}, {:text, text} | rest],
         n,
         origin,
         done
       ),
       do:
         parse_labels("IntervalTier", rest, n - 1, origin, [
           {parse_seconds(a) + origin, parse_seconds(b) + origin, text} | done
         ])

  defp parse_labels("TextTier", [{:number, a}, {:text, text} | rest], n, origin, done),
    do:
      parse_labels("TextTier", rest, n - 1, origin, [
        {parse_seconds(a) + origin, parse_seconds(a) + origin, text} | done
      ])

  defp parse_labels(_, _, _, _, _), do: :error

  # Parses digits, because a float cannot represent the ninth decimal of an hour.
  defp parse_seconds(text) do
    case Regex.run(~r/\A(-?)(\d*)(?:\.(\d+))?\z/, text) do
      [_, sign, whole] -> digits_to_ns(sign, whole, "")
      [_, sign, whole, fraction] -> digits_to_ns(sign, whole, fraction)
      nil -> text |> Float.parse() |> elem(0) |> Kernel.*(@s) |> round()
    end
  end

  defp digits_to_ns(sign, whole, fraction) do
    whole = if whole == "", do: 0, else: String.to_integer(whole)

    fraction =
      fraction |> String.slice(0, 9) |> String.pad_trailing(9, "0") |> String.to_integer()

    ns = whole * @s + fraction
    if sign == "-", do: -ns, else: ns
  end
end
