defmodule Situ.Store.CsvTest do
  use ExUnit.Case, async: true
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  test "a pipeline can replay CSV columns as streams, and a store can be copied from them", %{
    tmp_dir: root
  } do
    path = Path.join(root, "imu.csv")

    File.write!(path, """
    time_ms;acc;gyro;label
    0;1;0.5;"rest; still"
    10;2;1;walk
    20;3.5;;walk
    15;9;9;late
    30;x
    40;4;2.25;"say ""hi""\"
    """)

    store = Store.open!(path)

    assert [
             %{name: "acc", type: :float, count: 4},
             %{name: "gyro", count: 3},
             %{name: "label", type: :string}
           ] = Store.streams(store)

    assert Enum.map(Store.messages(store, "acc"), &{&1.originating_time, &1.data}) ==
             [{0, 1.0}, {10_000_000, 2.0}, {20_000_000, 3.5}, {40_000_000, 4.0}]

    assert Enum.map(Store.messages(store, "label"), & &1.data) == [
             "rest; still",
             "walk",
             "walk",
             "say \"hi\""
           ]

    assert [{_, 5, late}, {_, 6, short}] = Store.info(store).damage
    assert late =~ "increase" and short =~ "2 fields"
    {:ok, width, bins} = Store.summary(store, "acc", 0, 40_000_000, 2)
    assert width == 16_777_216
    assert Enum.map(bins, &elem(&1, 4)) == [2, 1, 1]

    {:ok, copy} = Store.copy(path, Path.join(root, "imu"))
    test = self()

    {:ok, _} =
      Pipeline.run(fn p ->
        for source <- [path, copy],
            do:
              p
              |> Store.importer(source)
              |> Store.stream("gyro")
              |> Situ.each(&send(test, {source, &1}))
      end)

    for source <- [path, copy], v <- [0.5, 1.0, 2.25], do: assert_received({^source, ^v})
  end

  test "reads times as ISO 8601, with units, and from a named column", %{tmp_dir: root} do
    times = fn text, opts ->
      path = Path.join(root, "t#{:erlang.phash2({text, opts})}.csv")
      File.write!(path, text)

      with {:ok, store} <- Store.open(path, reader_opts: opts),
           do:
             store |> Store.messages(hd(Store.streams(store))) |> Enum.map(& &1.originating_time)
    end

    assert times.("t,v\n1970-01-01T00:00:01.5Z,1\n1970-01-01T00:00:02Z,2\n", []) == [
             1_500_000_000,
             2_000_000_000
           ]

    assert times.("Timestamp (us),v\n5,1\n7,2\n", []) == [5_000, 7_000]
    assert times.("0.5,1\n1.5,2\n", []) == [500_000_000, 1_500_000_000]
    assert times.("v,when\n1,5\n2,6\n", time: "when", unit: :ms) == [5_000_000, 6_000_000]
    assert {:error, %{code: :not_csv, why: why}} = times.("v,when\n1,5\n", time: "whne")
    assert why =~ "when"
    assert {:error, %{code: :not_csv}} = times.("", [])
  end

  test "reads long files with quoted line breaks by time, by index and from the start",
       %{tmp_dir: root} do
    path = Path.join(root, "long.csv")
    n = 3_500

    rows =
      for i <- 0..(n - 1) do
        note = if rem(i, 7) == 0, do: ~s("line #{i},\r\nand ""more"""), else: "n#{i}"
        gap = if rem(i, 5) == 0, do: "", else: "#{i}"
        late = if rem(i, 1_000) == 999, do: "0,1,late,\r\n", else: ""
        "#{i},#{i}.5,#{note},#{gap}\r\n" <> late
      end

    File.write!(path, ["\uFEFFt_ms,x,note,007\r\n" | rows])
    store = Store.open!(path)

    assert [
             %{name: "x", type: :float, count: ^n},
             %{name: "note", type: :string, count: ^n},
             %{name: "007", type: :integer, count: 2_800}
           ] = Store.streams(store)

    assert [{_, line, "line " <> _}, _, _] = Store.info(store).damage
    # The late row follows the heading, 1,000 rows and 143 additional line breaks within quotes.
    assert line == 1 + 1_000 + 143 + 1
    assert [{0, "line 0,\r\nand \"more\""}, {1_000_000, "n1"}] = values(store, "note", 2)

    for {name, wanted} <- [
          {"x", for(i <- 0..(n - 1), do: {i, i + 0.5})},
          {"007", for(i <- 0..(n - 1), rem(i, 5) != 0, do: {i, i})}
        ] do
      assert values(store, name, n) == for({i, v} <- wanted, do: {i * 1_000_000, v})

      for {{i, v}, ordinal} <- Enum.with_index(wanted),
          rem(ordinal, 97) == 0 or i in 994..1_006 do
        assert {:ok, %{data: ^v, sequence_id: id}} = Store.at(store, name, ordinal)
        assert id == ordinal + 1
        assert {:ok, %{data: ^v}} = Store.first_at(store, name, i * 1_000_000)
        assert {:ok, %{data: ^v}} = Store.latest_at(store, name, i * 1_000_000 + 1)
      end
    end
  end

  defp values(store, name, n) do
    for m <- Enum.take(Store.messages(store, name), n), do: {m.originating_time, m.data}
  end

  test "an error for an invalid CSV file says where and why", %{tmp_dir: root} do
    why = fn text, opts ->
      path = Path.join(root, "bad#{:erlang.phash2({text, opts})}.csv")
      File.write!(path, text)
      assert {:error, %{code: :not_csv, why: why}} = Store.open(path, reader_opts: opts)
      why
    end

    assert why.("t,x\n1,2\n2,\xFF\n", []) =~ "line 3: it is not UTF-8"
    assert why.("only\n1\n", []) =~ "one column"
    assert why.("t,x\n1,2\n", separator: ", ") =~ "separator"

    assert why.(["t,x\n1,2\n2,\"", String.duplicate("x", 40_000_000)], []) =~
             "line 3: a row of more"

    # The strings of a string column stay as written.
    path = Path.join(root, "codes.csv")
    File.write!(path, "t,code\n0,007\n1,x\n")
    assert [{0, "007"}, {1_000_000_000, "x"}] = path |> Store.open!() |> values("code", 9)
    # A file that was truncated after opening is an error, not a crash.
    store = Store.open!(path)
    File.write!(path, "t,code\n")
    assert {:error, %{code: :damaged}} = Store.read(store, "code")
  end
end
