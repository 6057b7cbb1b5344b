defmodule Situ.Store.InspectTest do
  use ExUnit.Case, async: true
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  test "stores, writers and recordings show their path", %{tmp_dir: folder} do
    {:ok, report} =
      Situ.Pipeline.run(fn p ->
        store = Situ.Store.create(p, "hall", folder)
        p |> Situ.from_enumerable(1..3, every: 1) |> Situ.Store.write(store, "Count")
        {inspect(store), inspect(Situ.Store.create(p, "long", folder, split: Situ.Time.min(1)))}
      end)

    path = Path.join(folder, "hall.0000")
    {store, split} = report.result
    assert store == "#Situ.Store<writing #{inspect(path)}>"
    assert split == "#Situ.Store<writing #{inspect(Path.join(folder, "long"))}, split>"
    {:ok, recording} = Situ.Store.open(path)
    assert inspect(recording) == "#Situ.Recording<#{inspect(path)}>"
    {:ok, writer} = Writer.create("raw", folder)
    {:ok, stream} = Writer.stream(writer, "a")
    raw = inspect(Path.join(folder, "raw.0000"))
    assert inspect(writer) == "#Situ.Store.Writer<#{raw}>"
    assert inspect(stream) == ~s(#Situ.Store.Writer.Stream<"a", #{raw}>)
    :ok = Writer.close(writer)
  end
end
