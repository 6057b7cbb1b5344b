defmodule Situ.Bridge.TableImportTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge
  alias Situ.Bridge.{Format, TableImport}
  alias Situ.Message
  alias Situ.Store

  @moduletag :tmp_dir

  defp written(root, name, format, values) do
    path = Path.join(root, name)

    {records, n} =
      Enum.map_reduce(values, 0, fn {time, value}, n ->
        {Format.fetch_module!(format).record(value, time, n), n + 1}
      end)

    File.write!(path, [records, Format.fetch_module!(format).finish(n)])
    path
  end

  test "detects formats by extension, and CSV and JSON by first bytes too", %{tmp_dir: root} do
    values = [{100, 1}, {200, 2}]

    for {name, format} <- [
          {"a.csv", :csv},
          {"a.json", :json},
          {"a.JSONL", :json_lines},
          {"a.msgpack", :message_pack}
        ] do
      path = written(root, name, format, values)
      assert TableImport.detect_format(path) == format
      assert TableImport.table?(path)
    end

    for {name, bytes} <- [
          {"b.csv", "time,x\n1,2\n"},
          {"b.json", "{\"Streams\": []}"},
          {"c.csv", <<255, 0>>},
          {"d.json", ""}
        ] do
      File.write!(Path.join(root, name), bytes)
      assert TableImport.detect_format(Path.join(root, name)) == nil
    end

    assert TableImport.detect_format("x.wav") == nil
    refute TableImport.table?(Path.join(root, "missing.jsonl"))
    assert TableImport.stream_name("a/b.c.csv") == "b.c"
  end

  test "imports several tables as streams of one store, and reports progress", %{
    tmp_dir: root
  } do
    a = written(root, "a.jsonl", :json_lines, for(i <- 1..1_500, do: {i * 100, i}))
    b = written(root, "b.csv", :csv, [{100, "x"}])
    test = self()

    assert {:ok, path, %{"A" => 1_500, "b" => 1}} =
             TableImport.import([{"A", a, :json_lines}, {"b", b, :csv}], Path.join(root, "out"),
               progress: &send(test, &1)
             )

    assert_received 1_000
    assert_received 1_500
    store = Store.open!(path)

    assert for(i <- Store.streams(store), do: {i.name, i.type, i.count}) == [
             {"A", :integer, 1_500},
             {"b", :string, 1}
           ]
  end

  test "names skipped columns and rows once each", %{tmp_dir: root} do
    test = self()
    notice = &send(test, {:notice, &1})
    kinds = Path.expand("../../data/arrow/pyarrow-kinds.arrow", __DIR__)
    tables = [{"Kinds", kinds, :arrow}]

    assert {:ok, _, %{"Kinds" => 3}} =
             TableImport.import(tables, Path.join(root, "a"), notice: notice)

    assert_received {:notice, sentence}
    assert sentence =~ "u (union), r (run_end_encoded)"
    refute_received {:notice, _}

    late = Path.join(root, "late.parquet")

    parts = [
      for(t <- [1, 3, 2, 3, 4], do: %Message{data: t, originating_time: t, creation_time: t})
    ]

    {:ok, 5} = Bridge.Parquet.write_messages(parts, late)
    tables = [{"Late", late, :parquet}]

    assert {:ok, _, %{"Late" => 3}} =
             TableImport.import(tables, Path.join(root, "b"), notice: notice)

    assert_received {:notice, sentence}
    assert sentence =~ "skipped 2 rows"
    refute_received {:notice, _}
  end

  test "leaves no store after an error", %{tmp_dir: root} do
    out = Path.join(root, "out")
    twice = written(root, "t.jsonl", :json_lines, [{200, 1}, {100, 2}])

    assert {:error, %{code: :not_increasing}} =
             TableImport.import([{"T", twice, :json_lines}], out)

    assert {:error, %{code: :io}} =
             TableImport.import([{"T", Path.join(root, "no.jsonl"), :json_lines}], out)

    File.write!(twice, "nonsense\n\n")
    assert {:error, %{code: :bad_file}} = TableImport.import([{"T", twice, :json_lines}], out)

    assert {:error, %{code: :stream_exists}} =
             TableImport.import(
               List.duplicate({"T", written(root, "o.csv", :csv, [{1, 1}]), :csv}, 2),
               out
             )

    assert Path.wildcard(out <> "*") == []
  end
end
