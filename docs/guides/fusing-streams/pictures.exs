# Draws the diagrams of the guide "Fusing streams" from real runs:
#
#     mix run --no-start docs/guides/fusing-streams/pictures.exs      (any environment)
#
# The test of the guides draws them again and compares the results.
defmodule Situ.Guide.Pictures do
  alias Situ.{Available, Interval, Reproducible}

  @ms 1_000_000
  @width 720
  @left 110
  @scale 6.2

  # The camera sends an image every 20 ms. The tracker is irregular and sometimes silent.
  @camera Enum.map([0, 20, 40, 60, 80], &{&1, "c#{&1}"})
  @tracker Enum.map([2, 9, 17, 22, 31, 44, 68, 79], &{&1, &1})

  def all do
    %{
      "exact.svg" =>
        pairs(
          "Exact: the message at exactly that time",
          Reproducible.exact(),
          Interval.zero(),
          exact()
        ),
      "nearest.svg" =>
        pairs(
          "Nearest within 5 ms",
          Reproducible.nearest(5 * @ms),
          Interval.within(5),
          @tracker
        ),
      "first.svg" =>
        pairs(
          "First from now on",
          Reproducible.first(),
          Interval.future(15) |> open_end(),
          @tracker
        ),
      "last.svg" =>
        pairs(
          "Last up to now: the latest value",
          Reproducible.last(),
          Interval.past(15) |> open_start(),
          @tracker
        ),
      "linear.svg" => linear(),
      "waiting.svg" => waiting(),
      "window.svg" => window()
    }
  end

  def write(folder) do
    for {name, svg} <- all(), do: File.write!(Path.join(folder, name), svg)
  end

  defp exact, do: Enum.map([0, 9, 20, 31, 40, 44, 80], &{&1, &1})
  defp open_end(interval), do: %{interval | right_inclusive: false}
  defp open_start(interval), do: %{interval | left_inclusive: false}

  # Draws two rows of messages, a shaded window around each primary, and a line for each resulting pair.
  defp pairs(title, interpolator, window, tracker) do
    {:ok, joined} =
      Situ.Test.run([camera: timed(@camera), tracker: timed(tracker)], fn streams ->
        Situ.fuse(streams.camera, streams.tracker, interpolator)
      end)

    shades = for {t, _} <- @camera, do: shade(t + window.left, t + window.right)
    links = for {t, {_, from}} <- joined, do: link(div(t, @ms), from)
    outputs = for {t, {_, from}} <- joined, do: {div(t, @ms), "{c#{div(t, @ms)}, #{from}}"}

    svg(210, [
      title(title),
      shades,
      row("camera", 60, @camera, "#1f6feb", -14),
      row("tracker", 120, tracker, "#bf5700", 24),
      links,
      row("joined", 180, outputs, "#1a7f37", -12),
      axis(200)
    ])
  end

  # Draws the values between the neighbours as a plot.
  defp linear do
    level = [{0, 10}, {25, 40}, {50, 20}, {80, 70}]
    ticks = for t <- 0..90//10, do: {t, :tick}

    {:ok, outputs} =
      Situ.Test.run([level: timed(level), clock: timed(ticks)], fn streams ->
        Situ.sample(streams.level, streams.clock, Reproducible.linear())
      end)

    y = fn value -> 160 - value * 1.5 end
    points = Enum.map_join(level, " ", fn {t, v} -> "#{x(t)},#{num(y.(v))}" end)
    line = ~s(<polyline points="#{points}" fill="none" stroke="#bf5700" stroke-width="1"/>)
    given = for {t, v} <- level, do: dot(x(t), y.(v), 6, "#bf5700")
    made = for {t, v} <- outputs, do: dot(x(div(t, @ms)), y.(v), 3, "#1a7f37")

    svg(200, [
      title("Linear: between the neighbours, none beyond the last"),
      label("level", 100, "#bf5700"),
      label("every 10 ms", 120, "#1a7f37"),
      line,
      given,
      made,
      axis(180)
    ])
  end

  # Shows the result after each arrival, by feeding the same join message by message.
  defp waiting do
    feed = [tracker: 17, camera: 20, tracker: 22, camera: 40, tracker: 31, tracker: 44]
    right = outcomes(feed, Reproducible.nearest(5 * @ms))
    quick = outcomes(feed, Available.nearest(5 * @ms))

    columns =
      for {{{input, t}, i}, {r, a}} <-
            feed |> Enum.with_index() |> Enum.zip(Enum.zip(right, quick)) do
        cx = @left + 55 + i * 100

        [
          text(cx, 60, "#{input} #{t}", color(input), "middle"),
          text(cx, 110, r, "#1a7f37", "middle"),
          text(cx, 150, a, "#8250df", "middle")
        ]
      end

    svg(170, [
      title("Which output each arrival causes (nearest within 5 ms)"),
      label("arrives", 60, "#57606a"),
      label("Reproducible", 110, "#1a7f37"),
      label("Available", 150, "#8250df"),
      columns
    ])
  end

  defp outcomes(feed, interpolator) do
    build = fn streams -> Situ.fuse(streams.camera, streams.tracker, interpolator) end
    test = Situ.Test.start([:camera, :tracker], build, start: 1_000 * @ms)

    outcomes =
      for {input, t} <- feed do
        Situ.Test.feed(test, input, {t * @ms, t})

        case Situ.Test.outputs(test) do
          [] ->
            "-"

          outputs ->
            Enum.map_join(outputs, " ", fn {_, {c, tracker}} -> "{c#{c}, #{tracker}}" end)
        end
      end

    {:ok, _report} = Situ.Test.stop(test)
    outcomes
  end

  defp window do
    {:ok, outputs} =
      Situ.Test.run([tracker: timed(@tracker)], fn %{tracker: tracker} ->
        Situ.window(tracker, Interval.past(20 * @ms))
      end)

    bars =
      for {{t, list}, i} <- Enum.with_index(outputs) do
        at = div(t, @ms)
        y = 92 + i * 18

        [
          ~s(<line x1="#{x(max(at - 20, 0))}" y1="#{y}" x2="#{x(at)}" y2="#{y}" ) <>
            ~s(stroke="#1a7f37" stroke-width="8" opacity="0.25"/>),
          for(v <- list, do: dot(x(v), y, 3, "#1a7f37")),
          text(x(at) + 8, y + 4, inspect(list, charlists: :as_lists), "#1a7f37", "start")
        ]
      end

    svg(260, [
      title("Window: the last 20 ms, with every message"),
      row("tracker", 60, @tracker, "#bf5700", -12),
      bars,
      axis(240)
    ])
  end

  defp timed(messages), do: for({t, v} <- messages, do: {t * @ms, v})

  # SVG

  defp svg(height, parts) do
    body = parts |> List.flatten() |> Enum.join("\n  ")

    """
    <svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 #{@width} #{height}" font-family="sans-serif" font-size="11">
      <rect width="#{@width}" height="#{height}" fill="#ffffff"/>
      #{body}
    </svg>
    """
  end

  defp title(text),
    do: ~s(<text x="12" y="22" font-size="14" fill="#24292f">#{escape(text)}</text>)

  defp row(name, y, messages, color, offset) do
    [
      label(name, y + 4, color),
      ~s(<line x1="#{@left}" y1="#{y}" x2="#{@width - 20}" y2="#{y}" stroke="#d0d7de"/>),
      for {t, value} <- messages do
        [dot(x(t), y, 5, color), text(x(t), y + offset, value, color, "middle")]
      end
    ]
  end

  defp shade(from, to) do
    {from, to} = {max(from, -3), min(to, 93)}
    width = max((to - from) * @scale, 2)

    ~s(<rect x="#{x(from)}" y="45" width="#{num(width)}" height="90" fill="#1f6feb" opacity="0.08"/>)
  end

  defp link(t, from),
    do:
      ~s(<line x1="#{x(t)}" y1="60" x2="#{x(from)}" y2="120" stroke="#1a7f37" stroke-width="2"/>)

  defp axis(y) do
    for t <- 0..90//10, do: text(x(t), y, "#{t}", "#57606a", "middle")
  end

  defp label(text, y, color), do: text(12, y, text, color, "start")

  defp text(x, y, text, color, anchor) do
    ~s(<text x="#{num(x)}" y="#{num(y)}" fill="#{color}" text-anchor="#{anchor}">#{escape(text)}</text>)
  end

  defp dot(x, y, r, color),
    do: ~s(<circle cx="#{num(x)}" cy="#{num(y)}" r="#{r}" fill="#{color}"/>)

  defp color(:camera), do: "#1f6feb"
  defp color(:tracker), do: "#bf5700"

  defp x(t), do: num(@left + 20 + t * @scale)
  defp num(n) when is_integer(n), do: n
  defp num(n) when is_float(n), do: Float.round(n, 1)

  defp escape(value),
    do: value |> to_string() |> String.replace("&", "&amp;") |> String.replace("<", "&lt;")
end

if System.get_env("SITU_PICTURES") != "test" do
  {:ok, _} = Application.ensure_all_started(:situ)
  Situ.Guide.Pictures.write(__DIR__)
end
