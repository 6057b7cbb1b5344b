defmodule Situ.Media.Recording.WaveformTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  import Bitwise
  alias Situ.Media.Recording.Waveform

  defp waveform(points), do: Waveform.new() |> Waveform.add_points(points) |> Waveform.pack_bins()

  test "a gap takes no memory, whatever time a file claims" do
    ten_years = 315_360_000_000_000_000
    waveform = waveform([{0, -1.0, 1.0, 0.5, 8}, {ten_years, -2.0, 2.0, 1.0, 4}])
    assert byte_size(waveform.data) < 100

    assert [{0, -1.0, 1.0, 0.5, 8}, {_, -2.0, 2.0, 1.0, 4}] =
             Waveform.list_bins(waveform, 0, ten_years, 40)

    assert Waveform.list_bins(waveform, 1 <<< 41, ten_years - (1 <<< 41), 40) == []
  end

  property "bins contain the points grouped by time" do
    forall {steps, level, from, span} <-
             {list({integer(0, 200), integer(-9, 9)}), integer(24, 28), integer(0, 2_000),
              integer(0, 2_000)} do
      ms = 1_000_000

      {points, _} =
        Enum.map_reduce(steps, 0, fn {step, v}, t ->
          {{t + step * ms, v - 1.0, v + 1.0, v / 1, 2}, t + step * ms}
        end)

      first = (from * ms) >>> level
      last = ((from + span) * ms) >>> level

      expected =
        points
        |> Enum.group_by(&(elem(&1, 0) >>> level))
        |> Enum.sort()
        |> Enum.filter(fn {at, _} -> at in first..last end)
        |> Enum.map(fn {at, group} ->
          {at <<< level, group |> Enum.map(&elem(&1, 1)) |> Enum.min(),
           group |> Enum.map(&elem(&1, 2)) |> Enum.max(), group |> List.last() |> elem(3),
           2 * length(group)}
        end)

      assert Waveform.list_bins(waveform(points), from * ms, (from + span) * ms, level) ==
               expected
    end
  end
end
