defmodule Situ.Dataset.JsonStoreTest do
  use ExUnit.Case, async: true
  alias Situ.Store

  @moduletag :tmp_dir
  @catalog ~s([{"Name": "A", "Id": 1, "TypeName": "System.Int32, mscorlib", "IsClosed": false,
    "OpenedTime": "0001-01-01T00:00:00", "ClosedTime": "9999-12-31T23:59:59.9999999"},
    {"Name": "Empty", "Id": 5}])

  defp write(root, catalog, data) do
    File.write!(Path.join(root, "s.Catalog.json"), catalog)
    File.write!(Path.join(root, "s.Data.json"), data)
    Path.join(root, "s.Catalog.json")
  end

  defp entry(id, n, second, data) do
    time = "2020-01-01T00:00:0#{second}.5Z"

    envelope =
      ~s("SourceId": #{id}, "SequenceId": #{n}, "OriginatingTime": "#{time}", "Time": "#{time}")

    ~s({"Envelope": {#{envelope}}, "Data": #{data}})
  end

  test "reads streams, times, values and closed intervals", %{tmp_dir: root} do
    data =
      "[" <>
        Enum.join([entry(1, 0, 1, "7"), entry(1, 1, 2, "8"), entry(1, 2, 4, "9")], ",") <> "]"

    {:ok, store} = Store.open(write(root, @catalog, "\uFEFF" <> data))
    {:ok, info} = Store.stream_info(store, "A")
    assert {info.count, info.type, info.closed} == {3, :integer, nil}
    {:ok, from} = Situ.Time.parse("2020-01-01T00:00:02.5Z")
    assert store |> Store.messages("A", from: from) |> Enum.map(& &1.data) == [8, 9]
    assert store |> Store.messages("A", to: from) |> Enum.map(& &1.data) == [7, 8]
    assert {:ok, %{data: 8}} = Store.latest_at(store, "A", from + 1)
    assert Enum.to_list(Store.messages(store, "Empty")) == []
  end

  test "reports invalid and unassigned messages, and reads the rest", %{tmp_dir: root} do
    data = "[" <> Enum.join([entry(1, 0, 1, "7"), "7", "{}", entry(9, 1, 2, "8")], ",") <> "]"
    {:ok, store} = Store.open(write(root, @catalog, data))
    assert length(Store.info(store).damage) == 3
    assert [%{data: 7}] = Enum.to_list(Store.messages(store, "A"))
  end

  test "rejects truncated and missing files", %{tmp_dir: root} do
    path = write(root, @catalog, "[" <> entry(1, 0, 1, "7"))
    assert {:error, %{code: :damaged}} = Store.open(path)
    File.rm!(Path.join(root, "s.Data.json"))
    assert {:error, %{code: :damaged}} = Store.open(path)
    File.write!(Path.join(root, "other.json"), "{}")
    assert {:error, %{code: :unknown_format}} = Store.open(Path.join(root, "other.json"))
  end
end
