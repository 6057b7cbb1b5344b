defmodule Situ.Store.SinkTest do
  # A sink writes the messages that arrive, and keeps those written before an error.
  use ExUnit.Case, async: true
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  test "a failing pipeline leaves an intact, closed store", %{tmp_dir: root} do
    {:error, _} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "failing", root)

        p
        |> Situ.from_enumerable(for(i <- 1..100, do: {i * 1_000, i}))
        |> Store.write(exporter, "in")
        |> Situ.map(fn n -> if n == 60, do: raise("no"), else: n end)
        |> Store.write(exporter, "out")
      end)

    store = Store.open!(Path.join(root, "failing"))
    assert %{closed?: true, damage: []} = Store.info(store)
    out = store |> Store.messages("out") |> Enum.map(& &1.data)
    assert out == Enum.take(1..100, length(out))
  end

  test "a message that cannot be stored stops the pipeline and names the stream", %{tmp_dir: root} do
    {:error, error} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "bad", root)

        p
        |> Situ.from_enumerable([{1, 1}, {2, self()}])
        |> Store.write(exporter, "pids")
      end)

    assert Exception.message(error) =~ "process id"
  end
end
