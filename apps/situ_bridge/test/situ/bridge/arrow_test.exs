defmodule Situ.Bridge.ArrowTest do
  # Not async, because it counts atoms.
  use ExUnit.Case, async: false
  use Situ.Test.Property
  import ExUnit.CaptureLog
  alias Situ.Bridge.Arrow
  alias Situ.Bridge.Arrow.{Buffer, FlatBuffer, Values}
  alias Situ.Message
  alias Situ.Test.Budget
  doctest Arrow
  doctest Buffer
  doctest Values

  @moduletag :tmp_dir
  @fixtures Path.expand("../../data/arrow", __DIR__)

  defp written(dir, data, opts \\ []) do
    path = Path.join(dir, "rows.arrow")

    messages =
      for {value, i} <- Enum.with_index(data, 1),
          do: %Message{data: value, originating_time: i * 1_000, creation_time: i * 1_000 + 7}

    assert Arrow.write_messages([messages], path, opts) == {:ok, length(data)}
    path
  end

  defp values(path, opts \\ []), do: path |> Arrow.messages(opts) |> Enum.map(&elem(&1, 1))

  test "writes maps as columns, in as many batches as needed", %{tmp_dir: dir} do
    rows =
      for i <- 1..1_000,
          do: %{n: i, t: if(rem(i, 3) == 0, do: nil, else: "t#{i}"), p: %{x: i / 4}, l: [i]}

    path = written(dir, rows, rows: 300)

    assert values(path) ==
             for(r <- rows, do: %{"n" => r.n, "t" => r.t, "p.x" => r.p.x, "l" => "[#{r.n}]"})

    assert {:ok, table} = Arrow.File.open(path)
    assert length(table.groups) == 4
    assert table.times == ["originating_time", "creation_time"]

    assert [{1_007, %{"n" => 1}}] =
             path |> Arrow.messages(columns: ["n"], time: "creation_time") |> Enum.take(1)
  end

  test "exports a recording, and reads it in a pipeline", %{tmp_dir: dir} do
    levels = for i <- 1..5_000, do: {i, i / 7}
    truths = for i <- 1..5_000, do: {i, rem(i * i, 3) == 1}

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Situ.Store.create(p, "t", dir)
        p |> Situ.from_enumerable(levels) |> Situ.Store.write(store, "Level/a")
        p |> Situ.from_enumerable(truths) |> Situ.Store.write(store, "Truths")
      end)

    store = Situ.Store.open!(Path.join(dir, "t"))
    tables = Path.join(dir, "tables")

    assert Arrow.export(store, tables, rows: 999) ==
             {:ok, %{"Level/a" => 5_000, "Truths" => 5_000}}

    assert Enum.to_list(Arrow.messages(Path.join(tables, "Truths.arrow"))) == truths

    {:ok, 3_901} =
      Arrow.write(store, "Level/a", Path.join(dir, "part.arrow"), from: 100, to: 4_000)

    read = Situ.to_list(fn p -> Arrow.read(p, Path.join(tables, "Level_a.arrow")) end)
    assert read == Enum.map(levels, &elem(&1, 1))
  end

  property "reads back columns of every kind" do
    dir = System.tmp_dir!()

    forall {kind, n} <- {one_of([:integer, :float, :boolean, :text, :bytes]), integer(1, 40)} do
      data = for i <- 1..n, do: if(rem(i * n, 3) == 0, do: nil, else: cell(kind, i))
      path = written(dir, data, rows: 7)
      assert values(path) == data
    end
  end

  defp cell(:integer, i), do: (i - 20) * 1_000_000_000_000
  defp cell(:float, i), do: Enum.at([i / 3, :nan, :infinity, :neg_infinity], rem(i, 4))
  defp cell(:boolean, i), do: rem(i, 2) == 0
  defp cell(:text, i), do: String.duplicate("ä", rem(i, 5))
  defp cell(:bytes, i), do: <<0xFF, i>>

  # Written by pyarrow 25.0.1, as a file compressed with zstd and as a stream.
  test "reads files of another library with types that Situ does not write" do
    expected = [
      %{
        "d" => 86_400_000_000_000,
        "dec" => 1.0,
        "di" => "x",
        "fb" => "ab",
        "h" => 0.5,
        "n" => nil,
        "re" => "q",
        "sv" => "short",
        "u" => 1,
        "z" => 7
      },
      %{
        "d" => nil,
        "dec" => 2.0,
        "di" => "y",
        "fb" => "cd",
        "h" => 1.0,
        "n" => nil,
        "re" => "r",
        "sv" => "a much longer string than twelve",
        "u" => 2,
        "z" => 8
      },
      %{
        "d" => 3 * 86_400_000_000_000,
        "dec" => 3.0,
        "di" => "x",
        "fb" => "ef",
        "h" => 2.0,
        "n" => nil,
        "re" => "s",
        "sv" => "ééééééééé",
        "u" => 9_223_372_036_854_775_809,
        "z" => 9
      }
    ]

    for name <- ["pyarrow.arrow", "pyarrow.arrows"] do
      path = Path.join(@fixtures, name)

      rows = Enum.to_list(Arrow.messages(path))
      flat = for {time, row} <- rows, do: {time, Map.drop(row, ["l", "s", "m"])}
      assert flat == Enum.zip([1_000_000, 2_000_000, 3_000_000], expected)

      assert for({_, row} <- rows, do: Map.take(row, ["l", "s", "m"])) == [
               %{"l" => [1, 2], "m" => %{"k" => 1}, "s" => %{"a" => 1}},
               %{"l" => [3], "m" => %{}, "s" => %{"a" => 2}},
               %{"l" => [], "m" => nil, "s" => nil}
             ]

      assert {:ok, %{left_out: []}} = Arrow.list_columns(path)
    end
  end

  # Written by pyarrow 26.0.1.
  test "lists unsupported columns with their types" do
    path = Path.join(@fixtures, "pyarrow-kinds.arrow")

    left_out = [
      {"u", "union"},
      {"r", "run_end_encoded"},
      {"l", "list_view"},
      {"i", "interval"},
      {"d", "dictionary of lists"},
      {"s", "struct of list_view"}
    ]

    assert Arrow.list_columns(path) ==
             {:ok, %{columns: ["t", "n", "k", "n_2", "n_1"], left_out: left_out}}

    log =
      capture_log(fn ->
        assert values(path) == [
                 %{"k" => %{"k" => 7, "k_1" => "p"}, "n" => 7, "n_1" => 7, "n_2" => "x"},
                 %{"k" => %{"k" => 8, "k_1" => "q"}, "n" => 8, "n_1" => 8, "n_2" => "y"},
                 %{"k" => %{"k" => 9, "k_1" => "r"}, "n" => 9, "n_1" => 9, "n_2" => "z"}
               ]
      end)

    assert log =~ "u (union), r (run_end_encoded), l (list_view)"
    assert capture_log(fn -> values(path, columns: ["n"]) end) == ""

    error = assert_raise Situ.Error, fn -> Arrow.messages(path, columns: ["n", "u"]) end
    assert {error.code, error.fix} == {:no_column, "its type, union, is not supported"}
  end

  test "rejects a file whose columns are all unsupported" do
    path = Path.join(@fixtures, "pyarrow-unread.arrow")
    error = assert_raise Situ.Error, fn -> Arrow.messages(path) end
    assert error.code == :no_column
    assert error.why =~ "skipped: u (union), i (interval)"
  end

  test "applies a replaced dictionary to the batches after it" do
    path = Path.join(@fixtures, "pyarrow-dictionaries.arrows")
    assert values(path) == ["a", "b", "c", "d", "e", "c", nil] |> Enum.map(&%{"w" => &1})
  end

  test "reads rows across the parts of a batch", %{tmp_dir: dir} do
    rows = for i <- 1..3_000, do: %{n: i, t: String.duplicate("x", rem(i, 7)), b: rem(i, 3) == 0}
    path = written(dir, rows)
    read = for {_time, row} <- Arrow.messages(path), do: %{n: row["n"], t: row["t"], b: row["b"]}
    assert read == rows
  end

  test "rejects a file that is not a table, and says why", %{tmp_dir: dir} do
    path = Path.join(dir, "x.arrow")
    assert {:error, %{code: :io}} = Arrow.File.open(path)

    for {bytes, why} <- [
          {"", "does not begin"},
          {"PAR1", "does not begin"},
          {"ARROW1\0\0", "too short"},
          {"ARROW1\0\0 and then nothing more", "truncated"}
        ] do
      File.write!(path, bytes)
      assert {:error, %{code: :not_arrow, why: told}} = Arrow.File.open(path)
      assert told =~ why
    end

    whole = File.read!(written(dir, [1, 2, 3]))
    File.write!(path, binary_part(whole, 0, byte_size(whole) - 9))
    assert {:error, %{code: :not_arrow, why: why}} = Arrow.File.open(path)
    assert why =~ "truncated"

    assert {:error, %{code: :io}} =
             Arrow.write_messages(
               [[%Message{data: 1, originating_time: 1, creation_time: 1}]],
               Path.join(dir, "no/x")
             )
  end

  test "reads the complete batches of a truncated stream", %{tmp_dir: dir} do
    whole = File.read!(Path.join(@fixtures, "pyarrow.arrows"))
    path = Path.join(dir, "short.arrows")
    File.write!(path, binary_part(whole, 0, byte_size(whole) - 100))
    assert {:ok, %{groups: []}} = Arrow.File.open(path)
  end

  test "rejects overlapping views that would multiply the data" do
    view = <<20_000_000::little-32, "xxxx", 0::64>>
    views = :binary.copy(view, 100)
    data = :binary.copy("x", 20_000_000)

    buffers = [Buffer.from_binary(views), Buffer.from_binary(data)]
    column = %{type: {:view, :text}, rows: 100, presence: nil, buffers: buffers}
    column = Map.merge(column, %{children: [], entries: nil})
    assert {:not_arrow, why} = catch_throw(Values.read_rows(column, 0, 100))

    assert why =~ "2000000000 bytes"
  end

  property "decodes encoded tables of numbers and strings" do
    forall {a, b, texts} <-
             {integer(-100, 100), integer(0, 255), list(one_of(["", "ab", "äöü"]))} do
      inner = for text <- texts, do: {:table, [{0, {:ref, {:string, text}}}]}

      bytes =
        FlatBuffer.encode_table(
          {:table,
           [
             {0, {:i16, a}},
             {1, {:u8, b}},
             {3, {:i64, a * 1_000_000}},
             {4, {:ref, {:vector, inner}}}
           ]}
        )

      root = FlatBuffer.root_offset(bytes)
      assert FlatBuffer.read_number(bytes, root, 0, :i16, 0) == a
      assert FlatBuffer.read_number(bytes, root, 1, :u8, 0) == b
      assert FlatBuffer.read_number(bytes, root, 2, :i32, 7) == 7
      assert FlatBuffer.read_number(bytes, root, 3, :i64, 0) == a * 1_000_000

      assert for(
               t <- FlatBuffer.table_offsets(bytes, root, 4),
               do: FlatBuffer.read_string(bytes, t, 0)
             ) ==
               texts
    end
  end

  @tag :capture_log
  test "reads mutated files as rows or errors, and creates no atoms", %{tmp_dir: dir} do
    ours = for i <- 1..30, do: %{n: i, t: "text #{rem(i, 5)}", f: i / 3, b: rem(i, 2) == 0}

    files =
      for path <- [
            written(dir, ours, rows: 20),
            Path.join(@fixtures, "pyarrow.arrow"),
            Path.join(@fixtures, "pyarrow.arrows")
          ],
          do: File.read!(path)

    # Uses memory where a file system in memory exists.
    path =
      Path.join(
        if(File.dir?("/dev/shm"), do: "/dev/shm", else: dir),
        "situ-#{System.pid()}.arrow"
      )

    on_exit(fn -> File.rm(path) end)
    atoms = :erlang.system_info(:atom_count)

    count = Budget.mutation_count(2_000)

    outcomes =
      for n <- 1..count do
        whole = Enum.at(files, rem(n, 3))
        at = :rand.uniform(byte_size(whole)) - 1
        <<before::binary-size(at), _, rest::binary>> = whole
        rest = if rem(n, 10) == 0, do: binary_part(rest, 0, div(byte_size(rest), 2)), else: rest
        File.write!(path, [before, :rand.uniform(256) - 1, rest])
        read(path)
      end

    assert %{rows: rows, error: errors} = Enum.frequencies(outcomes)
    assert rows > div(count, 20) and errors > div(count, 20)
    assert :erlang.system_info(:atom_count) - atoms < 1_000
  end

  defp read(path) do
    assert path |> Arrow.messages() |> Enum.to_list() |> is_list()
    :rows
  rescue
    Situ.Error -> :error
  end
end
