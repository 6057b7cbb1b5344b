defmodule Situ.Annotation.Exchange.TextGrid do
  @moduledoc """
  Praat's TextGrid files: writes the long text form, and reads the long and the short form in UTF-8 or UTF-16.

  Each track (or track and attribute) is a tier. Praat requires intervals with an empty label between annotations,
  so an annotation with an empty label is lost. Points of a track are in a point tier `TRACK (points)`. Times are
  seconds from `origin:`, exact to the nanosecond.
  """
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation.Exchange.Rows
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
    tiers = Enum.flat_map(Rows.of(layer), &tiers/1)

    text = [
      ~s(File type = "ooTextFile"\nObject class = "TextGrid"\n\n),
      "xmin = #{seconds(first, opts)} \nxmax = #{seconds(elem(span, 1), opts)} \n",
      "tiers? <exists> \nsize = #{length(tiers)} \nitem []: \n",
      tiers |> Enum.with_index(1) |> Enum.map(&tier(&1, span, opts))
    ]

    empty = for {_, _, labels} <- Rows.of(layer), {_, ""} <- labels, do: 1
    losses = Rows.losses(annotations, [:by, :confidence, :note, :proposed?], "Praat")
    {text, losses ++ blank(length(empty)) ++ points(annotations)}
  end

  defp blank(0), do: []
  defp blank(n), do: ["Praat does not treat an empty label as an annotation: #{n} are lost"]

  defp points(annotations) do
    case Enum.count(annotations, &(&1.from == &1.to)) do
      0 -> []
      n -> ["Praat stores points in separate tiers: #{n} are on tiers called \"... (points)\""]
    end
  end

  defp tiers({_, name, labels}) do
    {points, intervals} = Enum.split_with(labels, fn {a, _} -> a.from == a.to end)

    if(intervals != [], do: [{:intervals, name, intervals}], else: []) ++
      if(points != [], do: [{:points, name <> " (points)", points}], else: [])
  end

  defp tier({{:intervals, name, labels}, n}, {first, last} = span, opts) do
    filled = fill(labels, first, last)

    [
      head(n, "IntervalTier", name, span, opts),
      "        intervals: size = #{length(filled)} \n",
      for {{from, to, text}, i} <- Enum.with_index(filled, 1) do
        """
                intervals [#{i}]:
                    xmin = #{seconds(from, opts)}
                    xmax = #{seconds(to, opts)}
                    text = #{quoted(text)}
        """
      end
    ]
  end

  defp tier({{:points, name, labels}, n}, span, opts) do
    [
      head(n, "TextTier", name, span, opts),
      "        points: size = #{length(labels)} \n",
      for {{a, text}, i} <- Enum.with_index(labels, 1) do
        "        points [#{i}]:\n            number = #{seconds(a.from, opts)} \n            mark = #{quoted(text)} \n"
      end
    ]
  end

  defp head(n, class, name, {first, last}, opts) do
    """
        item [#{n}]:
            class = "#{class}"
            name = #{quoted(name)}
            xmin = #{seconds(first, opts)}
            xmax = #{seconds(last, opts)}
    """
  end

  defp fill(labels, first, last) do
    {filled, at} =
      Enum.flat_map_reduce(labels, first, fn {a, text}, at ->
        gap = if a.from > at, do: [{at, a.from, ""}], else: []
        {gap ++ [{a.from, a.to, text}], a.to}
      end)

    if at < last, do: filled ++ [{at, last, ""}], else: filled
  end

  # Nanoseconds are written exactly, without a conversion to floats.
  defp seconds(time, opts) do
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

  defp quoted(text), do: ~s("#{String.replace(text, "\"", "\"\"")}")

  @impl true
  def decode(text, opts) do
    with {:ok, text} <- utf8(text),
         {:ok, rows} <- text |> scan([]) |> grid(opts[:origin] || 0) do
      {annotations, losses} = Rows.annotations(rows, opts[:schema])
      {:ok, nil, annotations, losses}
    end
  end

  defp utf8(<<0xFE, 0xFF, text::binary>>), do: utf16(text, :big)
  defp utf8(<<0xFF, 0xFE, text::binary>>), do: utf16(text, :little)
  defp utf8(<<0xEF, 0xBB, 0xBF, text::binary>>), do: utf8(text)

  # Old versions of Praat wrote Latin-1.
  defp utf8(text),
    do:
      {:ok, if(String.valid?(text), do: text, else: :unicode.characters_to_binary(text, :latin1))}

  defp utf16(text, endian) do
    case :unicode.characters_to_binary(text, {:utf16, endian}) do
      text when is_binary(text) -> {:ok, text}
      _ -> {:error, "it is neither UTF-8 nor UTF-16"}
    end
  end

  # Both forms contain the same sequence of quoted texts, numbers and flags; other words are only for human readers.
  defp scan("", done), do: Enum.reverse(done)

  defp scan("\"" <> text, done) do
    case quoted_text(text, "") do
      {:ok, value, rest} -> scan(rest, [{:text, value} | done])
      :error -> [:cut | done] |> Enum.reverse()
    end
  end

  defp scan("<exists>" <> rest, done), do: scan(rest, [:exists | done])

  defp scan("!" <> rest, done),
    do: rest |> String.split("\n", parts: 2) |> Enum.at(1, "") |> scan(done)

  # Item numbers in brackets are also only for human readers.
  defp scan("[" <> rest, done),
    do: rest |> String.split("]", parts: 2) |> Enum.at(1, "") |> scan(done)

  defp scan(<<c, _::binary>> = text, done) when c in ?0..?9 or c == ?- do
    [number] = Regex.run(~r/\A-?\d*(?:\.\d+)?(?:[eE][-+]?\d+)?/, text)

    rest =
      binary_part(text, max(byte_size(number), 1), byte_size(text) - max(byte_size(number), 1))

    scan(rest, if(number in ["", "-"], do: done, else: [{:number, number} | done]))
  end

  # Skips a complete word, because a digit in it is not a number.
  defp scan(<<c::utf8, _::binary>> = text, done) when c in ?a..?z or c in ?A..?Z do
    [word] = Regex.run(~r/\A\w+/u, text)
    scan(binary_part(text, byte_size(word), byte_size(text) - byte_size(word)), done)
  end

  defp scan(<<_::utf8, rest::binary>>, done), do: scan(rest, done)
  defp scan(_, done), do: Enum.reverse([:cut | done])

  defp quoted_text(text, value) do
    case String.split(text, "\"", parts: 2) do
      [part, "\"" <> rest] -> quoted_text(rest, value <> part <> "\"")
      [part, rest] -> {:ok, value <> part, rest}
      [_] -> :error
    end
  end

  defp grid(
         [{:text, "ooTextFile" <> _}, {:text, "TextGrid"}, {:number, _}, {:number, _} | rest],
         origin
       ) do
    case rest do
      [:exists, {:number, _} | tiers] -> rows(tiers, origin, [])
      _ -> {:ok, []}
    end
  end

  defp grid(_, _origin), do: {:error, "it does not start like a TextGrid file"}

  defp rows([], _origin, rows), do: {:ok, Enum.reverse(rows)}

  defp rows(
         [{:text, class}, {:text, name}, {:number, _}, {:number, _}, {:number, n} | rest],
         origin,
         rows
       )
       when class in ["IntervalTier", "TextTier"] do
    with {size, ""} when size <= 10_000_000 <- Integer.parse(n),
         {:ok, labels, rest} <- labels(class, rest, size, origin, []) do
      rows(rest, origin, [{name, Enum.reject(labels, &(elem(&1, 2) == ""))} | rows])
    else
      _ -> {:error, "the tier #{inspect(name)} is truncated or has invalid numbers"}
    end
  end

  defp rows(_, _origin, rows), do: {:error, "it is damaged after #{length(rows)} tiers"}

  defp labels(_class, rest, 0, _origin, done), do: {:ok, Enum.reverse(done), rest}

  defp labels(
         "IntervalTier",
         [{:number, a}, {:number, b}, {:text, text} | rest],
         n,
         origin,
         done
       ),
       do:
         labels("IntervalTier", rest, n - 1, origin, [
           {ns(a) + origin, ns(b) + origin, text} | done
         ])

  defp labels("TextTier", [{:number, a}, {:text, text} | rest], n, origin, done),
    do: labels("TextTier", rest, n - 1, origin, [{ns(a) + origin, ns(a) + origin, text} | done])

  defp labels(_, _, _, _, _), do: :error

  # Parses digits, because a float cannot represent the ninth decimal of an hour.
  defp ns(text) do
    case Regex.run(~r/\A(-?)(\d*)(?:\.(\d+))?\z/, text) do
      [_, sign, whole] -> signed(sign, whole, "")
      [_, sign, whole, fraction] -> signed(sign, whole, fraction)
      nil -> text |> Float.parse() |> elem(0) |> Kernel.*(@s) |> round()
    end
  end

  defp signed(sign, whole, fraction) do
    whole = if whole == "", do: 0, else: String.to_integer(whole)

    fraction =
      fraction |> String.slice(0, 9) |> String.pad_trailing(9, "0") |> String.to_integer()

    ns = whole * @s + fraction
    if sign == "-", do: -ns, else: ns
  end
end
