defmodule Situ.Store.Csv.ScanTest do
  use ExUnit.Case, async: true
  alias Situ.Store.Csv.Scan

  @moduletag :tmp_dir

  defp scan(root, text, opts \\ []) do
    path = Path.join(root, "t.csv")
    File.write!(path, text)
    Scan.run(path, opts)
  end

  test "separators, headings, kinds", %{tmp_dir: root} do
    assert {:ok, scan} = scan(root, "\uFEFFt;x;y\n1;1;a\n2;2.5;\n")
    assert {scan.separator, scan.time, scan.unit, scan.damage} == {?;, 0, :s, []}

    assert %{
             1 => %{name: "x", kind: :float, count: 2, first: 1_000_000_000, last: 2_000_000_000},
             2 => %{name: "y", kind: :string, count: 1, last: 1_000_000_000}
           } = scan.columns

    assert {:ok, scan} = scan(root, "1,10\n2,20\n")
    assert %{1 => %{name: "Column1", kind: :integer, count: 2}} = scan.columns
    assert {:ok, %{time: 1}} = scan(root, "x\tms\n1\t2\n", time: "ms")
    assert {:error, why} = scan(root, "a,b\n1,2\n", time: "c")
    assert why =~ "columns: a, b"
    assert {:error, "it has no column 2"} = scan(root, "a,b\n1,2\n", time: 2)
    assert {:error, why} = scan(root, "a,b\n", separator: "::")
    assert why =~ "separator"
  end

  test "rows that go back, or are too long, are told by their lines", %{tmp_dir: root} do
    {:ok, scan} = scan(root, "t,x\n1,1\n1,2\n0,3\n2,4,5\n3,6\nx,7\n", start: 100)
    assert %{1 => %{count: 2, first: 1_000_000_100, last: 3_000_000_100}} = scan.columns
    assert scan.damage |> Enum.map(&elem(&1, 1)) |> Enum.sort() == [3, 4, 5, 7]
  end

  test "every thousandth row has its place", %{tmp_dir: root} do
    text = ["t,x\n" | for(i <- 1..2_500, do: "#{i},#{rem(i, 3)}\n")]
    {:ok, scan} = scan(root, text)
    assert [third, second, first] = scan.parts
    assert {first.last, first.counts} == {nil, %{1 => 0}}
    assert {second.last, second.counts} == {1_000_000_000_000, %{1 => 1_000}}
    assert {:ok, [{_, ["2001", "0"]} | rest], _} = Scan.rows(scan, third.place)
    assert length(rest) == 499
  end
end
