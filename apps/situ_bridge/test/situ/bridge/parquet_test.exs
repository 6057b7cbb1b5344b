defmodule Situ.Bridge.ParquetTest do
  # Not async, because it counts atoms.
  use ExUnit.Case, async: false
  use Situ.Test.Property
  alias Situ.Bridge.Columnar.{Column, ColumnNames, Rows}
  alias Situ.Bridge.Parquet
  alias Situ.Bridge.Parquet.Writer
  alias Situ.Test.Budget
  alias Situ.Store
  doctest ColumnNames
  doctest Situ.Bridge.Gzip
  doctest Situ.Bridge.Parquet

  @theirs for kind <- 1..2,
              do: Path.expand("../../data/parquet/pyarrow-#{kind}.parquet", __DIR__)

  # Written by pyarrow 26.0.1: the columns t, x (plain), y, u, x (strings), x_1 (x as deltas), in
  # pages of few rows.
  @deltas Path.expand("../../data/parquet/pyarrow-deltas.parquet", __DIR__)

  @moduletag :tmp_dir

  defp recorded(dir, streams) do
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "t", dir)

        for {name, values} <- streams,
            do: p |> Situ.from_enumerable(values) |> Store.write(store, name)
      end)

    Store.open!(Path.join(dir, "t"))
  end

  test "exports streams as tables, and reads tables as streams", %{tmp_dir: dir} do
    rows =
      for i <- 1..1_000,
          do:
            {i * 1_000,
             %{n: i, t: if(rem(i, 3) == 0, do: nil, else: "t#{i}"), p: %{x: i / 4}, l: [i]}}

    levels = for i <- 1..500, do: {i, if(rem(i, 7) == 0, do: :nan, else: i / 2)}
    mixed = for {v, i} <- Enum.with_index([1, "two", nil, [3], 2 ** 70]), do: {i, v}
    image = Situ.Image.new!(width: 1, height: 1, format: :gray8, data: <<1>>)

    store =
      recorded(dir, [
        {"Rows", rows},
        {"Levels/a", levels},
        {"Mixed", mixed},
        {"Pictures", [{1, image}]}
      ])

    for compression <- [:none, :gzip] do
      folder = Path.join(dir, "#{compression}")
      counts = %{"Rows" => 1_000, "Levels/a" => 500, "Mixed" => 5}
      assert Parquet.export(store, folder, compression: compression, rows: 300) == {:ok, counts}

      expected =
        for {t, r} <- rows, do: {t, %{"n" => r.n, "t" => r.t, "p.x" => r.p.x, "l" => "[#{r.n}]"}}

      assert Enum.to_list(Parquet.messages(Path.join(folder, "Rows.parquet"))) == expected
      assert Enum.to_list(Parquet.messages(Path.join(folder, "Levels_a.parquet"))) == levels
      texts = [{0, "1"}, {1, "two"}, {2, nil}, {3, "[3]"}, {4, "#{2 ** 70}"}]
      assert Enum.to_list(Parquet.messages(Path.join(folder, "Mixed.parquet"))) == texts

      only =
        Parquet.messages(Path.join(folder, "Rows.parquet"), columns: ["n"], time: "creation_time")

      assert [{_, %{"n" => 1}}] = Enum.take(only, 1)
    end

    me = self()

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p
        |> Parquet.read(Path.join(dir, "none/Levels_a.parquet"))
        |> Situ.each(&send(me, {:got, &1}))
      end)

    assert_received {:got, 0.5}
    assert_received {:got, :nan}
  end

  test "writes plain numbers of one kind, of several kinds, and with gaps", %{tmp_dir: dir} do
    streams = [
      {"Floats", for(i <- 1..5_000, do: {i, i / 7})},
      {"Integers", for(i <- 1..5_000, do: {i, i * 1_000_000_007})},
      {"Truths", for(i <- 1..5_000, do: {i, rem(i * i, 3) == 1})},
      {"Both", for(i <- 1..5_000, do: {i, if(i < 2_500, do: i, else: i / 2)})},
      {"Holes", for(i <- 1..5_000, do: {i, if(rem(i, 1_700) == 0, do: nil, else: i)})}
    ]

    store = recorded(dir, streams)

    for {name, values} <- streams, compression <- [:none, :gzip] do
      file = Path.join(dir, "#{name}.parquet")
      assert Parquet.write(store, name, file, rows: 999, compression: compression) == {:ok, 5_000}
      assert Enum.to_list(Parquet.messages(file)) == values
      span = [from: 100, to: 4_000]
      assert Parquet.write(store, name, file, span) == {:ok, 3_901}
      assert Enum.to_list(Parquet.messages(file)) == Enum.slice(values, 99..3_999)
    end
  end

  describe "join/3" do
    setup %{tmp_dir: dir} do
      fast = for i <- 0..9, do: {i * 10, i}
      slow = [{5, %{x: 1.5, ok: true}}, {47, %{x: 2.5, ok: false}}, {200, %{x: 3.5, ok: true}}]
      %{store: recorded(dir, [{"Fast", fast}, {"Slow", slow}]), path: Path.join(dir, "j.parquet")}
    end

    defp rows(path),
      do: for({time, row} <- Parquet.messages(path), do: {time, row["Fast"], row["Slow.x"]})

    test "returns a row for each message with the nearest values of the others", %{
      store: store,
      path: path
    } do
      assert {:ok, 10} = Parquet.join(store, path, on: "Fast")

      assert rows(path) == [
               {0, 0, 1.5},
               {10, 1, 1.5},
               {20, 2, 1.5},
               {30, 3, 2.5},
               {40, 4, 2.5},
               {50, 5, 2.5},
               {60, 6, 2.5},
               {70, 7, 2.5},
               {80, 8, 2.5},
               {90, 9, 2.5}
             ]

      assert {:ok, 2} = Parquet.join(store, path, on: "Slow", streams: ["Fast"], to: 100)
      assert [{5, 0, 1.5}, {47, 5, 2.5}] = rows(path)
    end

    test "takes the latest values, or values within a tolerance", %{store: store, path: path} do
      assert {:ok, 10} = Parquet.join(store, path, on: "Fast", take: :latest)

      assert for({_, _, x} <- rows(path), do: x) ==
               [nil] ++ List.duplicate(1.5, 4) ++ List.duplicate(2.5, 5)

      assert {:ok, 10} = Parquet.join(store, path, on: "Fast", within: 6)

      assert for({t, _, x} <- rows(path), x != nil, do: {t, x}) == [
               {0, 1.5},
               {10, 1.5},
               {50, 2.5}
             ]

      assert {:ok, 3} = Parquet.join(store, path, on: "Fast", from: 20, to: 40, take: :latest)
      assert [{20, 2, 1.5}, {30, 3, 1.5}, {40, 4, 1.5}] = rows(path)
    end

    test "returns an error for an unknown stream", %{store: store, path: path} do
      assert {:error, %{code: :no_stream}} = Parquet.join(store, path, on: "None")

      assert {:error, %{code: :no_stream}} =
               Parquet.join(store, path, on: "Fast", streams: ["None"])

      refute File.exists?(path)
    end
  end

  # Written by pyarrow 25.0.1: the first with version 1 pages and LZ4, the second with version 2
  # pages and Snappy.
  test "reads files of another library with types and encodings Situ does not write" do
    expected = [
      {1_000_000,
       %{
         "list" => [1, nil],
         "deep" => [["a"], []],
         "struct" => %{"x" => 1, "y" => %{"z" => true}},
         "structs" => [%{"k" => 1}, %{"k" => 2}],
         "map" => %{"k" => 1},
         "decimal" => 1.25,
         "half" => 1.5,
         "time" => 1_000_000_000,
         "uuid" => "00010203-0405-0607-0809-0a0b0c0d0e0f",
         "prefix" => "same one",
         "long" => "ä",
         "apart" => 1.5
       }},
      {2_000_000,
       %{
         "list" => [],
         "deep" => nil,
         "struct" => nil,
         "structs" => [],
         "map" => %{},
         "decimal" => nil,
         "half" => -2.0,
         "time" => nil,
         "uuid" => "00010203-0405-0607-0809-0a0b0c0d0e0f",
         "prefix" => "same two",
         "long" => "",
         "apart" => 2.5
       }},
      {3_000_000,
       %{
         "list" => nil,
         "deep" => [nil],
         "struct" => %{"x" => nil, "y" => %{"z" => nil}},
         "structs" => nil,
         "map" => nil,
         "decimal" => -3.5,
         "half" => 0.0,
         "time" => 3_600_000_000_000,
         "uuid" => "00010203-0405-0607-0809-0a0b0c0d0e0f",
         "prefix" => "same",
         "long" => "xxxxxxxxx",
         "apart" => -3.5
       }}
    ]

    for path <- @theirs do
      assert Enum.to_list(Parquet.messages(path)) == expected

      assert [{1_000_000, %{"map" => %{"k" => 1}}} | _] =
               Enum.to_list(Parquet.messages(path, columns: ["map"]))
    end
  end

  test "wraps deltas at the width of their column" do
    rows = @deltas |> Parquet.messages() |> Enum.map(&elem(&1, 1))
    assert length(rows) == 300
    assert for(row <- rows, do: row["x_1"]) == for(row <- rows, do: row["x"])
    assert %{"x" => -2_147_483_648} = hd(rows)
    low_high = Enum.zip(0..299, Stream.cycle([-(2 ** 63), 2 ** 63 - 1, 7]))
    assert for(row <- rows, do: row["y"]) == for({i, y} <- low_high, do: if(rem(i, 5) > 0, do: y))

    assert for(row <- rows, do: row["u"]) ==
             for(i <- 0..299, do: if(rem(i, 7) > 0, do: 2 ** 32 - 1 - i))
  end

  test "reads columns with the same name, and numbers the later one" do
    assert Parquet.list_columns(@deltas) ==
             {:ok, %{columns: ["t", "x", "y", "u", "x_2", "x_1"], left_out: []}}

    for {_time, row} <- Parquet.messages(@deltas),
        do: assert(row["x_2"] == Integer.to_string(row["x"]))

    assert [{_, %{"x_2" => "-2147483648"}}] =
             @deltas |> Parquet.messages(columns: ["x_2"]) |> Enum.take(1)
  end

  defp write_table(path, columns, groups, compression \\ :none) do
    {:ok, writer} =
      Writer.create(path, columns, compression: compression, rows: length(hd(hd(groups))))

    writer =
      Enum.reduce(groups, writer, fn [first | _] = values, writer ->
        {:ok, writer} = Writer.write(writer, values, length(first))
        writer
      end)

    Writer.finish(writer)
  end

  defp time_and(column), do: [%Column{name: "t", kind: :time, optional?: false}, column]

  test "reads only as much of a file as is requested", %{tmp_dir: dir} do
    path = Path.join(dir, "damaged.parquet")
    noise = for _ <- 1..400, do: :crypto.strong_rand_bytes(100)
    {first, second} = Enum.split(noise, 200)
    groups = [[Enum.to_list(1..200), first], [Enum.to_list(201..400), second]]
    assert {:ok, 400} = write_table(path, time_and(%Column{name: "x", kind: :bytes}), groups)
    # The pages of the second row group are damaged. Those of the first are read without them.
    whole = File.read!(path)
    {at, _} = :binary.match(whole, hd(second))
    <<before::binary-size(at), _::binary-size(10_000), rest::binary>> = whole
    File.write!(path, [before, :binary.copy(<<255>>, 10_000), rest])
    assert path |> Parquet.messages() |> Enum.take(200) |> length() == 200
    assert_raise Situ.Error, ~r/cannot be read/, fn -> Enum.to_list(Parquet.messages(path)) end
    assert [{200, _}] = Enum.to_list(Parquet.messages(path, from: 200, to: 200))
  end

  test "reads the rows between two times", %{tmp_dir: dir} do
    path = Path.join(dir, "times.parquet")
    groups = for g <- 0..9, do: List.duplicate(Enum.to_list((g * 100)..(g * 100 + 99)), 2)
    {:ok, 1_000} = write_table(path, time_and(%Column{name: "x", kind: :integer}), groups)
    table = Situ.Error.unwrap!(Parquet.File.open(path))
    assert [_, _] = Parquet.File.select_groups(table, hd(table.columns), {250, 399})
    read = fn opts -> for {t, %{"x" => t}} <- Parquet.messages(path, opts), do: t end
    assert read.(from: 250, to: 399) == Enum.to_list(250..399)
    assert read.(from: 990) == Enum.to_list(990..999)
    assert read.(to: -1) == []
  end

  test "rejects a column with fewer rows than its group, and drops no row", %{tmp_dir: dir} do
    path = Path.join(dir, "short.parquet")
    values = Enum.to_list(1..77)

    {:ok, 77} =
      write_table(path, time_and(%Column{name: "x", kind: :integer}), [[values, values]])

    # The footer claims two rows more than the columns have: 154 and 158 are twice these numbers.
    File.write!(path, :binary.replace(File.read!(path), <<0x9A, 1>>, <<0x9E, 1>>, [:global]))
    error = assert_raise Situ.Error, fn -> Enum.to_list(Parquet.messages(path)) end
    assert error.code == :not_parquet
  end

  @tag :capture_log
  test "reads mutated pyarrow files as rows or errors in bounded memory", %{tmp_dir: dir} do
    path = Path.join(dir, "theirs.parquet")
    seed = Budget.random_seed()
    whole = Enum.map(@theirs, &File.read!/1)

    mutate = fn ->
      :rand.seed(:exsss, seed)
      Process.flag(:max_heap_size, %{size: 50_000_000, kill: true, error_logger: true})

      for _ <- 1..Budget.mutation_count(200), bytes = Enum.random(whole) do
        at = :rand.uniform(byte_size(bytes)) - 1
        <<before::binary-size(at), _, rest::binary>> = bytes
        File.write!(path, [before, :rand.uniform(256) - 1, rest])

        try do
          Enum.count(Parquet.messages(path))
        rescue
          Situ.Error -> :error
        end
      end
    end

    results = Task.await(Task.async(mutate), :infinity)
    assert :error in results and 3 in results
  end

  test "rejects a file that is not a table, and says why", %{tmp_dir: dir} do
    path = Path.join(dir, "x.parquet")
    File.write!(path, "PAR1 this is none PAR1")
    assert_raise Situ.Error, ~r/cannot be read/, fn -> Enum.to_list(Parquet.messages(path)) end
    assert {:error, %{code: :not_parquet}} = Parquet.File.open(path)
    assert {:error, %{code: :io}} = Parquet.File.open(Path.join(dir, "nothing"))
    {:ok, 1} = write_table(path, [%Column{name: "x", kind: :integer}], [[[1]]])
    error = assert_raise Situ.Error, fn -> Parquet.messages(path) end
    assert error.code == :no_column
    assert {:error, %{code: :io}} = Writer.create(Path.join(dir, "no/such/x"), [], [])
  end

  # A schema of a few kilobytes can be nested so deeply that reading it overflows the stack.
  test "rejects a schema that is nested too deeply", %{tmp_dir: dir} do
    path = Path.join(dir, "deep.parquet")
    # Each group is a struct of Thrift: repetition (field 3), name (field 4), one child (field 5).
    group = <<0x35, 0, 0x18, 1, "g", 0x15, 2, 0>>
    leaf = <<0x15, 2, 0x25, 0, 0x18, 1, "x", 0>>
    root = <<0x48, 1, "r", 0x15, 2, 0>>

    for n <- [100, 1_000_000] do
      elements = [root, :binary.copy(group, n), leaf]
      list = [0x19, 0xFC, encode_varint(n + 2), elements]
      footer = IO.iodata_to_binary([0x15, 2, list, 0x16, 0, 0x19, 0x0C, 0])
      File.write!(path, ["PAR1", footer, <<byte_size(footer)::little-32>>, "PAR1"])
      assert {:error, %{code: :not_parquet}} = Parquet.File.open(path)
    end
  end

  defp encode_varint(n) when n < 128, do: <<n>>
  defp encode_varint(n), do: <<1::1, n::7>> <> encode_varint(div(n, 128))

  property "reads back columns of every kind and compression", count: 30 do
    forall {kind, compression, n, size} <-
             {one_of([:integer, :float, :boolean, :text, :bytes]),
              one_of([:none, :snappy, :gzip, :zstd]), integer(1, 300), integer(1, 90)} do
      values = for i <- 1..n, do: if(rem(i * n, 3) == 0, do: nil, else: cell(kind, i))
      path = Path.join(System.tmp_dir!(), "situ-#{System.unique_integer([:positive])}.parquet")
      groups = for part <- Enum.chunk_every(values, size), do: [part]
      {:ok, ^n} = write_table(path, [%Column{name: "x", kind: kind}], groups, compression)
      {:ok, table} = Parquet.File.open(path)
      rows = Enum.to_list(Parquet.File.stream_rows(table, table.groups, table.columns))
      File.rm!(path)
      assert rows == Enum.map(values, &[&1])
    end
  end

  defp cell(:integer, i), do: ((i - 20) * 1_000_000_000_000_000_000) |> rem(2 ** 63)
  defp cell(:float, i), do: Enum.at([i / 3, :nan, :infinity, :neg_infinity], rem(i, 4))
  defp cell(:boolean, i), do: rem(i, 2) == 0
  defp cell(:text, i), do: String.duplicate("ä", rem(i, 5))
  defp cell(:bytes, i), do: <<255, i::16>>

  property "reads back nested columns", numtests: 30 do
    forall {seed, n} <- {integer(1, 100_000), integer(1, 60)} do
      :rand.seed(:exsss, seed)
      rows = for i <- 1..n, do: {i, nested_row()}

      messages =
        for {t, row} <- rows, do: %Situ.Message{data: row, originating_time: t, creation_time: t}

      path = Path.join(System.tmp_dir!(), "situ-#{System.unique_integer([:positive])}.parquet")
      {:ok, ^n} = Parquet.write_messages([messages], path, nested: true, rows: 17)
      found = Enum.to_list(Parquet.messages(path))
      File.rm!(path)
      assert found == rows
    end
  end

  defp nested_row do
    %{
      "list" => maybe(fn -> some(fn -> maybe(fn -> :rand.uniform(300) end) end) end),
      "deep" => some(fn -> maybe(fn -> some(fn -> :rand.uniform(2) == 1 end) end) end),
      "structs" =>
        some(fn ->
          maybe(fn -> %{"x" => maybe(&:rand.uniform/0), "t" => some(fn -> "ä" end)} end)
        end),
      "struct" => %{"in" => %{"y" => maybe(fn -> "y" end), "z" => some(fn -> nil end)}}
    }
  end

  defp maybe(fun), do: if(:rand.uniform(4) > 1, do: fun.())
  defp some(fun), do: for(_ <- 1..(:rand.uniform(4) - 1)//1, do: fun.())

  test "writes structs, tuples and values of different types as nested columns", %{tmp_dir: dir} do
    path = Path.join(dir, "nested.parquet")
    point = %{x: 1, y: {1, 2.5}}

    messages =
      for {data, i} <- [
            {%{p: point, m: 1}, 1},
            {%{p: nil, m: [2]}, 2},
            {%{p: %{y: {}}, m: "3"}, 3}
          ],
          do: %Situ.Message{data: data, originating_time: i, creation_time: i}

    assert {:ok, 3} = Parquet.write_messages([messages], path, nested: true)

    assert Enum.map(Parquet.messages(path), &elem(&1, 1)) == [
             %{"m" => "1", "p" => %{"x" => 1, "y" => [1.0, 2.5]}},
             %{"m" => "[2]", "p" => nil},
             %{"m" => "3", "p" => %{"x" => nil, "y" => []}}
           ]
  end

  test "writes and reads packed columns in several row groups", %{tmp_dir: dir} do
    path = Path.join(dir, "packed.parquet")
    x = for i <- 1..1_000, into: <<>>, do: <<i / 3::little-float-64>>
    b = for i <- 1..1_000, into: <<>>, do: <<rem(i, 2)>>
    texts = for i <- 1..1_000, do: if(rem(i, 3) > 0, do: "t#{i}")
    columns = [{"x", {:float, x}}, {"b", {:boolean, b}}, {"s", {:text, texts}}]
    assert Parquet.write_columns(columns, path, rows: 300) == {:ok, 1_000}
    parts = Enum.to_list(Parquet.columns(path))
    join = fn name, kind -> for %{^name => {^kind, bytes}} <- parts, into: <<>>, do: bytes end
    assert {join.("x", :float), join.("b", :boolean)} == {x, b}
    assert Enum.flat_map(parts, & &1["s"]) == texts
    assert [%{"b" => _} = part | _] = Enum.to_list(Parquet.columns(path, columns: ["b"]))
    assert map_size(part) == 1

    assert_raise Situ.Error, ~r/no column/, fn ->
      Enum.to_list(Parquet.columns(path, columns: ["y"]))
    end

    assert {:error, %{code: :not_writable}} =
             Parquet.write_columns([{"x", {:float, <<>>}} | tl(columns)], path)

    assert {:error, %{code: :not_writable}} =
             Parquet.write_columns([{"x", {:integer, <<1>>}}], path)
  end

  test "stores values of mixed kinds as strings" do
    kinds =
      Enum.reduce(
        [%{a: 1, b: nil}, %{a: 2.5, b: true}, %{a: nil, b: 1}],
        %{},
        &Rows.merge_data_kinds(&2, &1)
      )

    assert [%{name: "a", kind: :float}, %{name: "b", kind: :text}] =
             columns = Rows.build_columns(kinds)

    assert Rows.row_values(%{a: 1, b: true}, columns) == [1, "true"]
  end

  @tag :capture_log
  test "reads mutated files as rows or errors, and creates no atoms", %{tmp_dir: dir} do
    rows = for i <- 1..50, do: {i, %{n: i, t: "text #{rem(i, 5)}", f: i / 3, b: rem(i, 2) == 0}}
    {:ok, _} = dir |> recorded([{"Rows", rows}]) |> Parquet.export(dir, rows: 20)
    whole = File.read!(Path.join(dir, "Rows.parquet"))
    path = Path.join(dir, "mutated.parquet")
    atoms = :erlang.system_info(:atom_count)

    for n <- 1..Budget.mutation_count(150), do: from_disk(path, mutated(whole, n))

    assert :erlang.system_info(:atom_count) - atoms < 1_000
  end

  defp mutated(whole, n) do
    # Most of the important bytes are in the footer and in the page headers.
    at =
      if rem(n, 2) == 0,
        do: :rand.uniform(byte_size(whole)) - 1,
        else: byte_size(whole) - :rand.uniform(400)

    <<before::binary-size(at), _, rest::binary>> = whole
    before <> <<:rand.uniform(256) - 1>> <> rest
  end

  defp from_disk(path, bytes) do
    File.write!(path, bytes)
    assert path |> Parquet.messages() |> Enum.to_list() |> is_list()
  rescue
    Situ.Error -> :ok
  end
end
