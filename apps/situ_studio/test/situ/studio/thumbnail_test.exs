defmodule Situ.Studio.ThumbnailTest do
  use ExUnit.Case, async: true

  alias Situ.Studio.{Asking, History, Thumbnail, Recordings}

  defp drawn(rows) do
    {:ok, "image/svg+xml", svg} = Thumbnail.render_thumbnail(Asking.source("Only", rows))
    [_, path] = Regex.run(~r/ d="([^"]*)"/, IO.iodata_to_binary(svg))
    path
  end

  # Returns the runs of a path, each a list of strokes {x, top, bottom}.
  defp runs(path) do
    for run <- String.split(path, "M", trim: true) do
      for stroke <- String.split(run, "L") do
        [x, top, bottom] = stroke |> String.split([" ", "V"]) |> Enum.map(&String.to_float/1)
        {x, top, bottom}
      end
    end
  end

  test "draws a single number as a level line, and nothing for an empty stream" do
    assert [[{0.0, 86.0, 86.0}, {160.0, 86.0, 86.0}]] = runs(drawn([{5, 1.5}]))
    assert Thumbnail.render_thumbnail(Recordings.History.wrap(History.new(live: false))) == :none
  end

  test "draws nothing across a gap of hours" do
    hour = 3_600_000_000_000
    rows = for i <- Enum.concat(0..4_000, 12_000..16_000), do: {i * 2_000_000_000, :math.sin(i)}
    assert List.last(rows) |> elem(0) < 9 * hour

    assert [before, later] = runs(drawn(rows))
    assert before |> List.last() |> elem(0) < 41.0
    assert later |> hd() |> elem(0) > 119.0
  end

  test "draws one outlier among 100,000 messages at its height" do
    rows = for i <- 0..99_999, do: {i * 1_000_000, if(i == 61_803, do: 50.0, else: 0.0)}
    assert [run] = runs(drawn(rows))
    assert [{x, 4.0, 86.0}] = Enum.filter(run, fn {_, top, _} -> top < 80 end)
    assert_in_delta x, 160 * 0.618, 1.1
  end

  test "draws the largest floats" do
    assert [run] = runs(drawn(for i <- 0..9, do: {i * 1_000, 1.7e308 * (rem(i, 2) * 2 - 1)}))
    assert Enum.map(run, &elem(&1, 1)) |> Enum.uniq() |> Enum.sort() == [4.0, 86.0]
  end
end
