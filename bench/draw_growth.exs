# Draws the results of `bin/bench growth`:
#
#     elixir bench/draw_growth.exs RESULTS [EARLIER_RESULTS] > bench/growth.svg
#
# Earlier results are drawn as dashed lines.
defmodule DrawGrowth do
  @width 360
  @height 260
  @columns 3
  # The drawing area of a panel: left, top, width and height.
  @area {52, 54, 290, 145}
  @colours ~w(#1f5fa8 #c2410c #15803d #7e22ce)

  # A series is its label, the name of the metric before and after the size, and optionally
  # whether its value is divided by the size.
  @panels [
    {"Messages through ten maps", "us of CPU per message", "messages",
     [
       {"one process", "messages_chained", "_cpu"},
       {"a process each", "messages_processes", "_cpu"}
     ]},
    {"Length of a chain", "us of CPU per message and map", "maps",
     [
       {"one process", "chain_chained", "_cpu", :per_size},
       {"a process each", "chain_processes", "_cpu", :per_size}
     ]},
    {"Streams in a pipeline", "us of CPU per message, with start and end", "streams",
     [{"source, map, sink", "streams", "_cpu"}]},
    {"Start and end of a stream", "ms of CPU per stream", "streams",
     [{"source, map, sink", "stream_start_end", "_cpu"}]},
    {"Stopping a running pipeline", "ms of CPU per stage or stream", "stages or streams",
     [
       {"stage, one process", "stop_stage_chained", "_cpu"},
       {"own process", "stop_stage_process", "_cpu"},
       {"stream", "stop_stream", "_cpu"}
     ]},
    {"Streams joined in a row", "us of CPU per input message", "streams",
     [{"join", "joins", "_cpu"}]},
    {"Branches of a parallel", "us of CPU per part, with the start", "branches",
     [{"by values", "branches", "_cpu"}]},
    {"Streams in a store", "us of CPU per message", "streams",
     [{"written", "store_write", "_cpu"}, {"read", "store_read", "_cpu"}]},
    {"Streams in a store: memory", "MiB at the peak", "streams", [{"resident", "store_rss", ""}]},
    {"Memory of a waiting pipeline", "KiB per stage or stream", "stages or streams",
     [
       {"stage, one process", "memory_stage_chained", ""},
       {"own process", "memory_stage_process", ""},
       {"stream", "memory_stream", ""}
     ]},
    {"Schedulers", "us of CPU per message", "schedulers",
     for kind <- ~w(chained processes fanout join) do
       {kind, "schedulers_" <> kind, "_cpu"}
     end}
  ]

  @figures [
    {"1 kHz, one process, p50 / p99 / p99.9", ~w(latency_chained_p50 latency_chained_p99
      latency_chained_p999), "us"},
    {"1 kHz, ten processes, p50 / p99 / p99.9", ~w(latency_processes_p50 latency_processes_p99
      latency_processes_p999), "us"},
    {"bin/situ --version, wall / CPU", ~w(startup_situ startup_situ_cpu), "ms"},
    {"pipeline: empty, wall / CPU", ~w(startup_pipeline_create_run_dispose
      startup_pipeline_create_run_dispose_cpu), "ms"},
    {"pipeline: source and sink, wall / CPU",
     ~w(startup_pipeline_source_sink startup_pipeline_source_sink_cpu), "ms"}
  ]

  def main([file | earlier]) when length(earlier) < 2 do
    runs = Enum.map([file | earlier], &read/1)
    rows = div(length(@panels) + @columns, @columns)
    {width, height} = {@columns * @width, rows * @height}

    panels = @panels |> Enum.map(&panel(&1, runs)) |> Enum.concat([figures(runs)])

    IO.puts([
      ~s(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 #{width} #{height}" ),
      ~s(width="#{width}" height="#{height}" font-family="sans-serif" font-size="12">\n),
      ~s(<rect width="100%" height="100%" fill="#fff"/>\n),
      panels |> Enum.with_index() |> Enum.map(&place/1),
      "</svg>"
    ])
  end

  def main(_) do
    IO.puts(:stderr, "Usage: elixir bench/draw_growth.exs RESULTS [EARLIER_RESULTS] > FILE.svg")
    System.halt(2)
  end

  defp read(file) do
    for line <- File.stream!(file),
        "growth_" <> name <- [line],
        [name, value, _unit] <- [String.split(name, ",")],
        into: %{},
        do: {name, value |> Float.parse() |> elem(0)}
  end

  defp place({content, i}) do
    at = "#{rem(i, @columns) * @width} #{div(i, @columns) * @height}"
    [~s|<g transform="translate(#{at})">\n|, content, "</g>\n"]
  end

  defp panel({title, unit, size, series}, runs) do
    lines =
      for {spec, colour} <- Enum.zip(series, @colours),
          {run, earlier?} <- Enum.zip(runs, [false, true]),
          points = points(spec, run),
          points != [],
          do: {elem(spec, 0), colour, earlier?, points}

    all = Enum.flat_map(lines, &elem(&1, 3))
    scale = {sizes(all), axis_end(all)}

    [
      text(10, 20, title, ~s(font-weight="bold" font-size="14")),
      text(10, 36, unit, ~s(fill="#666")),
      axes(scale, size),
      Enum.map(lines, &line(&1, scale)),
      legend(for {label, colour, false, _} <- lines, do: {label, colour})
    ]
  end

  defp points({_label, prefix, suffix}, run) do
    pattern = ~r/^#{prefix}_(\d+)#{suffix}$/

    Enum.sort(
      for {name, value} <- run,
          [_, size] <- [Regex.run(pattern, name)],
          do: {String.to_integer(size), value}
    )
  end

  defp points({label, prefix, suffix, :per_size}, run),
    do: for({size, value} <- points({label, prefix, suffix}, run), do: {size, value / size})

  defp sizes([]), do: [1]
  defp sizes(points), do: points |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort()

  # The next of 1, 2, 3, 5 or 10 times a power of ten above the largest value.
  defp axis_end([]), do: 1.0

  defp axis_end(points) do
    most = points |> Enum.map(&elem(&1, 1)) |> Enum.max() |> max(1.0e-6)
    power = :math.pow(10, floor(:math.log10(most)))
    Enum.find([1, 2, 3, 5, 10], &(&1 * power >= most)) * power
  end

  defp axes({sizes, most}, label) do
    {left, top, width, height} = @area
    bottom = top + height

    horizontal =
      for part <- [0, 0.5, 1] do
        y = bottom - part * height

        [
          ~s(<path d="M#{left} #{y}h#{width}" stroke="#ddd"/>\n),
          text(left - 6, y + 4, number(most * part), ~s(text-anchor="end" fill="#666"))
        ]
      end

    ticks =
      for size <- sizes do
        text(x(size, sizes), bottom + 15, short(size), ~s(text-anchor="middle" fill="#666"))
      end

    [horizontal, ticks, text(left + width, bottom + 30, label, ~s(text-anchor="end" fill="#666"))]
  end

  defp line({_label, colour, earlier?, points}, {sizes, most}) do
    {_, top, _, height} = @area

    points =
      for {size, value} <- points,
          do: {x(size, sizes), Float.round(top + height * (1 - value / most), 1)}

    path = Enum.map_join(points, "L", fn {x, y} -> "#{x} #{y}" end)
    dashes = if earlier?, do: ~s( stroke-dasharray="4 3" opacity="0.6")

    [
      ~s(<path d="M#{path}" fill="none" stroke="#{colour}" stroke-width="2"#{dashes}/>\n),
      for({x, y} <- points, not earlier?, do: dot(x, y, colour))
    ]
  end

  defp dot(x, y, colour), do: ~s(<circle cx="#{x}" cy="#{y}" r="3" fill="#{colour}"/>\n)

  # Sizes have a logarithmic axis.
  defp x(size, sizes) do
    {left, _, width, _} = @area
    {least, most} = {:math.log(hd(sizes)), :math.log(List.last(sizes))}
    share = if most > least, do: (:math.log(size) - least) / (most - least), else: 0.5
    Float.round(left + width * (0.03 + 0.94 * share), 1)
  end

  # Labels follow one another with about 7 pixels per character.
  defp legend(entries) do
    {_, top, _, height} = @area
    y = top + height + 46

    {marks, _x} =
      Enum.map_reduce(entries, 14, fn {label, colour}, x ->
        {[dot(x, y - 4, colour), text(x + 8, y, label, "")], x + 30 + 7 * String.length(label)}
      end)

    marks
  end

  defp figures(runs) do
    rows =
      for {{label, names, unit}, i} <- Enum.with_index(@figures) do
        y = 48 + i * 38
        values = Enum.map_join(runs, ", earlier ", &figure(&1, names, unit))
        [text(10, y, label, ~s(fill="#666")), text(10, y + 16, values, ~s(font-size="14"))]
      end

    [text(10, 20, "Latency and startup", ~s(font-weight="bold" font-size="14")), rows]
  end

  defp figure(run, names, unit) do
    values = Enum.map_join(names, " / ", &if(run[&1], do: number(run[&1]), else: "-"))
    values <> " " <> unit
  end

  defp short(size) when size >= 1_000_000, do: "#{div(size, 1_000_000)}M"
  defp short(size) when size >= 1_000, do: "#{div(size, 1_000)}k"
  defp short(size), do: "#{size}"

  defp number(value) when value == 0, do: "0"
  defp number(value) when value >= 10, do: value |> round() |> Integer.to_string()
  defp number(value) when value >= 1, do: :erlang.float_to_binary(value * 1.0, decimals: 1)
  defp number(value), do: :erlang.float_to_binary(value * 1.0, [:compact, decimals: 3])

  defp text(x, y, content, attributes),
    do: ~s(<text x="#{x}" y="#{y}" #{attributes}>#{escape(content)}</text>\n)

  defp escape(text), do: String.replace(text, ["&", "<"], &%{"&" => "&amp;", "<" => "&lt;"}[&1])
end

DrawGrowth.main(System.argv())
