defmodule Situ.Bridge.TablesTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.{Format, Tables}
  alias Situ.Store

  @moduletag :tmp_dir

  defp written(root, name, format, values) do
    path = Path.join(root, name)

    {records, n} =
      Enum.map_reduce(values, 0, fn {time, value}, n ->
        {Format.module!(format).record(value, time, n), n + 1}
      end)

    File.write!(path, [records, Format.module!(format).finish(n)])
    path
  end

  test "a file is known by its ending, CSV and JSON by their first bytes too", %{tmp_dir: root} do
    values = [{100, 1}, {200, 2}]

    for {name, format} <- [
          {"a.csv", :csv},
          {"a.json", :json},
          {"a.JSONL", :json_lines},
          {"a.msgpack", :message_pack}
        ] do
      path = written(root, name, format, values)
      assert Tables.format(path) == format
      assert Tables.table?(path)
    end

    for {name, bytes} <- [
          {"b.csv", "time,x\n1,2\n"},
          {"b.json", "{\"Streams\": []}"},
          {"c.csv", <<255, 0>>},
          {"d.json", ""}
        ] do
      File.write!(Path.join(root, name), bytes)
      assert Tables.format(Path.join(root, name)) == nil
    end

    assert Tables.format("x.wav") == nil
    refute Tables.table?(Path.join(root, "missing.jsonl"))
    assert Tables.name("a/b.c.csv") == "b.c"
  end

  test "several tables are streams of one store, and progress tells of their messages", %{
    tmp_dir: root
  } do
    a = written(root, "a.jsonl", :json_lines, for(i <- 1..1_500, do: {i * 100, i}))
    b = written(root, "b.csv", :csv, [{100, "x"}])
    test = self()

    assert {:ok, path, %{"A" => 1_500, "b" => 1}} =
             Tables.import([{"A", a, :json_lines}, {"b", b, :csv}], Path.join(root, "out"),
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

  test "an error leaves no store", %{tmp_dir: root} do
    out = Path.join(root, "out")
    twice = written(root, "t.jsonl", :json_lines, [{200, 1}, {100, 2}])
    assert {:error, %{code: :not_increasing}} = Tables.import([{"T", twice, :json_lines}], out)

    assert {:error, %{code: :io}} =
             Tables.import([{"T", Path.join(root, "no.jsonl"), :json_lines}], out)

    File.write!(twice, "nonsense\n\n")
    assert {:error, %{code: :bad_file}} = Tables.import([{"T", twice, :json_lines}], out)

    assert {:error, %{code: :stream_exists}} =
             Tables.import(
               List.duplicate({"T", written(root, "o.csv", :csv, [{1, 1}]), :csv}, 2),
               out
             )

    assert Path.wildcard(out <> "*") == []
  end
end
