defmodule Situ.Store.KeyRecorderTest do
  use ExUnit.Case, async: true
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  test "stores the keys of a stream's maps in its metadata", %{tmp_dir: root} do
    maps = for i <- 1..100, do: {i * 1_000, if(i == 50, do: :none, else: %{rem(i, 7) => i})}

    {:ok, report} =
      Pipeline.run(fn p ->
        store = Store.create(p, "keys", root)

        p
        |> Situ.from_enumerable(maps)
        |> Store.write(store, "Faces", keys: true, metadata: %{"unit" => "px"})

        p |> Situ.from_enumerable([{1_000, 1}]) |> Store.write(store, "Numbers", keys: true)
        store.path
      end)

    store = Store.open!(report.result)
    assert Store.closed?(store)

    assert Store.metadata(store, "Faces") ==
             {:ok, %{"unit" => "px", "keys" => Enum.to_list(0..6)}}

    assert {:error, %{code: :no_metadata}} = Store.metadata(store, "Numbers")
    assert Store.count(store, "Faces") == 100
  end
end
