defmodule Situ.Bench.StoreSeek do
  # Random reads by time.
  alias Situ.{Pipeline, Store}

  def tests, do: []

  def seek(name, root, n, number, every \\ 100) do
    store = Store.open!(Path.join(root, "bench"))
    {:ok, info} = Store.stream_info(store, "s")
    :rand.seed(:exsss, {1, 2, 3})

    times =
      for _ <- 1..10_000 do
        i = :rand.uniform(n) - 1
        started = :erlang.monotonic_time(:nanosecond)
        {:ok, message} = Store.latest_at(store, info, i * every + 50)
        took = :erlang.monotonic_time(:nanosecond) - started
        if number.(message.data) != i, do: raise("sought #{i}, found #{inspect(message)}")
        took
      end

    sorted = times |> Enum.sort() |> List.to_tuple()
    at = fn p -> elem(sorted, trunc(p * (tuple_size(sorted) - 1))) / 1_000 end
    [{"#{name}_seek_p50", at.(0.5), "us"}, {"#{name}_seek_p99", at.(0.99), "us"}]
  end

  def record(root, n) do
    {:ok, _} =
      Pipeline.run(
        fn p ->
          exporter = Store.create(p, "bench", root)

          p
          |> Situ.from_enumerable(0..(n - 1)//1, every: 100)
          |> Store.write(exporter, "s", type: :integer)
        end,
        pipeline: [replay: [speed: :max, interval: {0, :unbounded}]]
      )
  end
end

defmodule Situ.Bench.Seek do
  # 10,000 random reads by time in a store of 1,000,000 integers, and the time to open the store.
  def tests, do: [{"seek", &seek/1}]

  defp seek(scale) do
    n = max(1, round(1_000_000 * scale))
    root = Path.join(System.tmp_dir!(), "situ-bench-seek-#{System.pid()}-#{n}")
    File.rm_rf!(root)
    File.mkdir_p!(root)

    try do
      Situ.Bench.StoreSeek.record(root, n)
      started = :erlang.monotonic_time(:nanosecond)
      Situ.Store.open!(Path.join(root, "bench"))
      opened = :erlang.monotonic_time(:nanosecond) - started
      Situ.Bench.StoreSeek.seek("seek", root, n, & &1) ++ [{"seek_open", opened / 1.0e6, "ms"}]
    after
      File.rm_rf!(root)
    end
  end
end
