defmodule Situ.CsvRowTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.CsvRow
  doctest CsvRow

  defp field,
    do: map(list(one_of([?a, ?,, ?", ?\r, ?\n, ?\s, 0xE9])), &List.to_string/1)

  # A record of one empty field is an empty line.
  defp row, do: map({field(), list(field())}, fn {first, rest} -> [first <> "x" | rest] end)

  property "reads the records that it writes" do
    forall rows <- list(row()) do
      text = rows |> Enum.map(&CsvRow.encode_row/1) |> IO.iodata_to_binary()
      CsvRow.parse_rows(text) == {:ok, rows}
    end
  end

  property "reads or refuses any text" do
    forall text <- binary() do
      case CsvRow.parse_rows(text) do
        {:ok, rows} -> Enum.all?(rows, &is_list/1)
        {:error, why} -> is_binary(why)
      end
    end
  end

  test "a record that may go on asks for more" do
    assert CsvRow.parse_row("a,b", false) == :more
    assert CsvRow.parse_row("a,\"b\"", false) == :more
    assert CsvRow.parse_row("a,\"b\"\r\nc", false) == {:ok, ["a", "b"], "c"}
  end
end
