defmodule Situ.Bench.Columns do
  # Floats as columns: computed in a pipeline, and from a recording to another one. Each part is checked by its sum.
  alias Situ.{Columns, Pipeline, Store}

  @part 50_000
  @replay [replay: [speed: :max]]

  def tests, do: [{"columns", &run(max(1, round(80 * &1)))}]

  defp run(parts) do
    n = parts * @part
    columns = for i <- 0..(parts - 1), do: part(i)
    root = Situ.Bench.folder!()

    try do
      compute(columns, n) ++ record(columns, n, root) ++ copy(n, root)
    after
      File.rm_rf!(root)
    end
  end

  defp part(i) do
    times = for t <- 1..@part, into: <<>>, do: <<(i * @part + t) * 100::little-64>>
    values = for t <- 1..@part, into: <<>>, do: <<t * 0.5::little-float-64>>
    %Columns{kind: :float, count: @part, times: times, values: values}
  end

  # The function itself costs nothing.
  defp pass(stream), do: Situ.map(stream, & &1.values, columns: true)

  defp count(stream, counter),
    do: Situ.each(stream, &:counters.add(counter, 1, &1.count), columns: true)

  defp compute(columns, n) do
    measure("columns_compute", n, fn p, counter ->
      p |> Situ.from_enumerable(columns) |> pass() |> pass() |> count(counter)
    end)
  end

  defp record(columns, n, root) do
    measure("columns_write", n, fn p, counter ->
      store = Store.create(p, "floats", root)
      p |> Situ.from_enumerable(columns) |> count(counter) |> Store.write(store, "V")
    end)
  end

  defp copy(n, root) do
    path = Path.join(root, "floats")

    measure("columns_read", n, fn p, counter ->
      p |> Store.importer(path) |> Store.stream("V") |> count(counter)
    end) ++
      measure("columns_copy", n, fn p, counter ->
        store = Store.create(p, "copy", root)

        p
        |> Store.importer(path)
        |> Store.stream("V")
        |> pass()
        |> count(counter)
        |> Store.write(store, "V")
      end)
  end

  defp measure(metric, n, build) do
    counter = :counters.new(1, [])

    Situ.Bench.measure(metric, n, "msg/s", fn ->
      {:ok, _} = Pipeline.run(&build.(&1, counter), pipeline: @replay)

      if :counters.get(counter, 1) != n,
        do: raise("#{:counters.get(counter, 1)} of #{n} messages")

      []
    end)
  end
end
