defmodule Situ.Python.LogLinesTest do
  use ExUnit.Case, async: true
  alias Situ.Python.LogLines
  doctest LogLines

  defp add_lines(lines, texts, now) do
    Enum.flat_map_reduce(texts, lines, fn text, lines -> LogLines.add_line(lines, text, now) end)
  end

  test "reads levels, and shows bytes that are not text" do
    {entries, _} = add_lines(%LogLines{}, ["<3>a", "<7>b", "<9>c", <<255>>], 0)
    assert entries == [{:error, "a"}, {:debug, "b"}, {:info, "<9>c"}, {:info, "<<255>>"}]
  end

  test "limits the lines of a second, and keeps the last ones" do
    {entries, lines} = add_lines(%LogLines{}, Enum.map(1..1_000, &"#{&1}"), 500)
    assert length(entries) == 200
    assert [{:warning, note}, {:info, "next"}] = elem(LogLines.add_line(lines, "next", 1_000), 0)
    assert note =~ "800 lines were not logged"
    assert LogLines.last_lines(lines) == Enum.map_join(981..1_000, "\n", &"#{&1}")
  end
end
