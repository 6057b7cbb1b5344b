defmodule Situ.Bridge.Format.Csv.TableTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Format.Csv.Table
  alias Situ.CsvRow

  defp messages(values) do
    for {value, i} <- Enum.with_index(values),
        do: %Situ.Message{data: value, originating_time: i * 100, creation_time: 0}
  end

  defp rows(values) do
    columns = Table.collect_columns([messages(values)])
    text = [Table.encode_heading(columns), Table.encode_rows(messages(values), columns)]

    {:ok, [["_OriginatingTime_" | heading] | rows]} =
      text |> IO.iodata_to_binary() |> CsvRow.parse_rows()

    [heading | Enum.map(rows, &tl/1)]
  end

  test "gives every value a column" do
    assert rows([
             %{acceleration: {0.5, 1.5, -2.0}, name: "a"},
             %{acceleration: nil, faces: [%{left: 1}, %{left: 2, on: true}]}
           ]) == [
             ~w(acceleration[0] acceleration[1] acceleration[2] name acceleration) ++
               ~w(faces[0].left faces[1].left faces[1].on),
             ["0.5", "1.5", "-2", "a", "", "", "", ""],
             ["", "", "", "", "", "1", "2", "True"]
           ]

    assert rows([[1, 2], [3]]) == [["_Column0_", "_Column1_"], ["1", "2"], ["3", ""]]
    assert rows([7, "x"]) == [["_Value_"], ["7"], ["x"]]
  end

  test "names members of two objects by their paths if their names are the same" do
    assert rows([%{face: %{x: 1, y: 2}, hand: %{x: 3}}]) == [["face.x", "y", "hand.x"], ~w(1 2 3)]
  end

  test "writes bytes that are no text as base64" do
    assert rows([%{data: <<255, 216>>}]) == [["data"], ["/9g="]]
  end

  test "refuses messages with thousands of values" do
    error = assert_raise Situ.Error, fn -> rows([Enum.to_list(1..1_001)]) end
    assert error.what =~ "more than 1000 values"
    assert error.fix =~ "Parquet"
  end

  defp number_list, do: list(integer())

  property "keeps all numbers of lists of any length" do
    forall values <-
             nonempty_list(
               map({number_list(), number_list()}, fn {a, b} -> %{a: a, b: %{c: b}} end)
             ) do
      [heading | rows] = rows(values)

      for {value, row} <- Enum.zip(values, rows) do
        cells = Map.new(Enum.zip(heading, row))

        for {name, list} <- [{"a", value.a}, {"c", value.b.c}],
            {n, i} <- Enum.with_index(list),
            do: assert(cells["#{name}[#{i}]"] == to_string(n))
      end

      true
    end
  end
end
