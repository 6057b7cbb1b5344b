defmodule Situ.Store.Csv.ScanTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Csv.{Field, Scan}

  @moduletag :tmp_dir

  defp scan(root, text, opts \\ []) do
    path = Path.join(root, "t.csv")
    File.write!(path, text)
    Scan.scan_file(path, opts)
  end

  test "detects separators, headings and types", %{tmp_dir: root} do
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

  test "reports the lines of late, long and unreadable rows", %{tmp_dir: root} do
    {:ok, scan} = scan(root, "t,x\n1,1\n1,2\n0,3\n2,4,5\n3,6\nx,7\n", start: 100)
    assert %{1 => %{count: 2, first: 1_000_000_100, last: 3_000_000_100}} = scan.columns
    assert scan.damage |> Enum.map(&elem(&1, 1)) |> Enum.sort() == [3, 4, 5, 7]
  end

  test "remembers the position of every thousandth row", %{tmp_dir: root} do
    text = ["t,x\n" | for(i <- 1..2_500, do: "#{i},#{rem(i, 3)}\n")]
    {:ok, scan} = scan(root, text)
    assert [third, second, first] = scan.parts
    assert {first.last, first.counts} == {nil, %{1 => 0}}
    assert {second.last, second.counts} == {1_000_000_000_000, %{1 => 1_000}}
    assert {:ok, [{_, ["2001", "0"]} | rest], _} = Scan.read_rows(scan, third.place)
    assert length(rest) == 499
  end

  property "native and plain code read the same values" do
    root = Path.join(System.tmp_dir!(), "situ-csv-#{System.unique_integer([:positive])}")
    File.mkdir_p!(root)
    on_exit(fn -> File.rm_rf!(root) end)

    fields =
      [
        "",
        " ",
        "1",
        "-2",
        "+3",
        "007",
        "1.5",
        "2e3",
        ".5",
        "5.",
        "1e400",
        "nan",
        "x",
        "ä",
        ~s("q,""1""\nz")
      ] ++
        ["12345678901234567890", "1_000", " 4 ", "-0.0", "1e-400"]

    times = %{
      s: ["", "x", "-5", "0.25", "1e3", "99999999999", "1e300"],
      iso8601:
        [
          "",
          "2020-01-31",
          "2021-02-29T00:00:00Z",
          "2020-01-31 12:34:56",
          "2020-01-31T12:34:56.5+02:00"
        ] ++
          [
            "2020-01-31T12:34:57.1234567891Z",
            "2020-01-31T24:00:00Z",
            "9999-01-01T00:00:00Z",
            "1969-12-31T23:59:59Z"
          ]
    }

    forall {unit, rows} <-
             {one_of([:s, :iso8601]),
              list(
                {integer(0, 40), one_of([:time, :odd]), one_of(fields), one_of(fields),
                 integer(0, 9)}
              )} do
      lines =
        for {n, which, a, b, dice} <- rows do
          time = if which == :time or dice > 2, do: time(unit, n), else: Enum.random(times[unit])
          if dice == 0, do: "#{time},#{a}", else: "#{time},#{a},#{b}"
        end

      heading = "t,a,b\n#{time(unit, 0)},1,2\n"
      {:ok, scan} = scan(root, heading <> Enum.join(lines, "\r\n"), unit: unit)
      assert_plain(scan)
    end
  end

  defp time(:s, n), do: "#{n}"
  defp time(:iso8601, n), do: "2020-01-31T12:34:#{String.pad_leading("#{n}", 2, "0")}Z"

  # Compares with rows and fields that are read one after the other.
  defp assert_plain(scan) do
    for part <- scan.parts, {index, column} <- scan.columns do
      {:ok, rows, _} = Scan.read_rows(scan, part.place)
      {kept, damage, _} = Scan.keep_valid_rows(rows, part.last, scan)

      texts =
        for {time, row} <- kept,
            text = String.trim(elem(row, index)),
            text != "",
            do: {time, text}

      kind =
        Enum.reduce(texts, nil, fn {_, text}, kind ->
          Field.merge_kinds(kind, Field.infer_kind(text))
        end)

      assert {kind, length(texts)} == {column.kind, column.count}
      assert damage == scan.damage
      values = for {time, text} <- texts, do: {time, Field.parse_as(text, kind)}
      assert Scan.read_values(scan, part, index) == {:ok, values}
    end
  end
end
