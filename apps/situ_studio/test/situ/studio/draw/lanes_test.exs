Code.require_file("../../../../../../test/browser/random_fixture.exs", __DIR__)

defmodule Situ.Studio.Draw.LanesTest do
  # Compares the lanes of random recordings in random windows with the messages. The browser test
  # "7 random" checks the same with fewer windows. SEED reproduces the recordings of a failed run.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking, only: [ask: 2, json: 1]
  alias Situ.Studio.{DataSession, Recordings}

  @moduletag :tmp_dir
  @t0 1_767_225_600_000_000_000
  @recordings 12
  @windows 20
  @places 6
  # The width of a panel. A segment near the mouse is in its pixel or in an adjacent one.
  @px 560
  @near_px 5
  # In a pause of so many periods, messages are certainly missing.
  @missing 30

  test "a lane shows the same as the messages at any position", %{tmp_dir: dir} do
    told = Path.join(dir, "told.json")
    seed = RandomFixture.record(dir, told, @recordings)
    {:ok, %{"recordings" => recordings}} = Situ.JSON.decode(File.read!(told))

    for %{"name" => name, "length" => length, "streams" => streams} <- recordings do
      {:ok, source} = Recordings.Store.open(Path.join(dir, name))
      lanes = for s <- streams, s["kind"] in ["boolean", "state", "map"], do: s

      for n <- 1..@windows, window = window(n, length), stream <- lanes do
        look(source, stream, window, "SEED=#{seed} #{name}")
      end
    end
  end

  # The first window is the entire recording.
  defp window(1, length), do: {0, length}

  defp window(_n, length) do
    width = max(round(length * :math.pow(2.0e-4, :rand.uniform())), 1_000)
    {round(:rand.uniform() * (length - width)), width}
  end

  defp look(source, %{"name" => name, "rows" => rows} = stream, {from, width}, run) do
    drawn = drawn(source, name, from, width)
    rows = rows |> Enum.map(&List.to_tuple/1) |> List.to_tuple()
    slack = @near_px * div(width, @px) + 1_100_000

    for _ <- 1..@places, key <- if(stream["kind"] == "map", do: ["a", "b"], else: [""]) do
      t = from + round(:rand.uniform() * width)

      said =
        Enum.find(drawn, fn {a, b, _, lane} -> lane == key and a <= t and (b == nil or b > t) end)

      at = "#{run} #{name} #{key} at #{t} in #{from}+#{width}: #{inspect(said)}"
      check(said, {rows, key, stream["period"]}, t, slack, at)
    end
  end

  # Requests the segments like the page: half a view more on both sides, in bins of its pixels.
  defp drawn(source, name, from, width) do
    bin = Integer.pow(2, max(0, floor(:math.log2(width / @px))))
    first = @t0 + Integer.floor_div(from - div(width, 2), bin) * bin
    last = @t0 + from + width + div(width, 2)

    {%{frames: [%{kind: 2, base: base, payload: payload}]}, _} =
      ask(DataSession.new(source), %{
        "open" => [[1, %{"stream" => name, "viz" => "states"}]],
        "series" => [[1, Integer.to_string(first), Integer.to_string(last), bin]]
      })

    for [a, b, label, _class | lane] <- json(payload),
        do: {base + a - @t0, b && base + b - @t0, label, List.first(lane) || ""}
  end

  defp check(nil, {rows, _, _}, t, _slack, at) do
    n = up_to(rows, t)

    if n > 0 and n < tuple_size(rows),
      do: assert(time(rows, n) - time(rows, n - 1) > usual(rows), "#{at}: nothing is drawn")
  end

  defp check({a, b, label, _}, {rows, key, period}, t, slack, at) do
    {first, last} =
      {up_to(rows, a + slack), if(b, do: up_to(rows, b - slack), else: tuple_size(rows))}

    if label =~ ~r/\d/ do
      near =
        max(up_to(rows, a - slack) - 1, 0)..(up_to(rows, (b || last_time(rows)) + slack) - 1)//1

      assert length(Enum.uniq(for i <- near, do: value(rows, i, key))) > 1,
             "#{at}: all are the same"
    else
      for i <- first..(last - 1)//1,
          do: assert(value(rows, i, key) == label, "#{at}: message #{i}")

      near = max(up_to(rows, t - slack) - 1, 0)..(up_to(rows, t + slack) - 1)//1
      assert Enum.any?(near, &(value(rows, &1, key) == label)), "#{at}: no message says so"
      if period != 0, do: hole(rows, up_to(rows, t), period, {t, slack}, at)
    end
  end

  defp hole(rows, n, period, {t, slack}, at) when n > 0 and n < tuple_size(rows) do
    {before, later} = {time(rows, n - 1), time(rows, n)}
    pause = later - before

    if pause > @missing * period + 4 * slack,
      do: assert(t < before + pause / 4 or t > later - slack, "#{at}: in a hole of #{pause} ns")
  end

  defp hole(_rows, _n, _period, _at, _text), do: :ok

  defp time(rows, i), do: elem(elem(rows, i), 0)
  defp last_time(rows), do: time(rows, tuple_size(rows) - 1)

  defp value(rows, i, ""), do: to_string(elem(elem(rows, i), 1))
  defp value(rows, i, key), do: to_string(elem(elem(rows, i), 1)[key])

  defp usual(rows) do
    pauses = for i <- 1..(tuple_size(rows) - 1)//1, do: time(rows, i) - time(rows, i - 1)
    Enum.at(Enum.sort(pauses), div(length(pauses), 2), 0)
  end

  # Returns the number of messages at or before a time.
  defp up_to(rows, t), do: up_to(rows, t, 0, tuple_size(rows))

  defp up_to(rows, t, low, high) when low < high do
    mid = div(low + high, 2)
    if time(rows, mid) <= t, do: up_to(rows, t, mid + 1, high), else: up_to(rows, t, low, mid)
  end

  defp up_to(_rows, _t, low, _high), do: low
end
