defmodule Situ.Bench.Parallel do
  # Branches by key and by position, with map(+1) in each, and 100,000 live branches.

  alias Situ.Delivery

  @policies [
    {"unlimited", &Delivery.unlimited/0},
    {"throttle", &Delivery.throttle/0},
    {"sync", &Delivery.synchronous/0}
  ]

  def tests do
    forms =
      for {name, policy} <- @policies,
          {form, run} <- [{"sparse", &sparse/3}, {"fixed", &fixed/3}],
          do: {"parallel#{form}-#{name}", &run.(name, policy.(), &1)}

    forms ++
      [
        {"parallel-processes", &processes/1},
        {"parallel-processes-maps", &processes_of_maps/1},
        {"parallel-100k", &many/1}
      ]
  end

  defp sparse(name, policy, scale) do
    n = max(1, round(20_000 * scale))
    map = Map.new(0..9, &{&1, &1})

    run("parallel_sparse10_" <> name, n, policy, map, fn stream ->
      stream |> Situ.parallel(&add_one/1, of: :maps) |> Situ.map(&Enum.sum(Map.values(&1)))
    end)
  end

  defp fixed(name, policy, scale) do
    n = max(1, round(30_000 * scale))

    run("parallel_fixed10_" <> name, n, policy, Enum.to_list(0..9), fn stream ->
      stream |> Situ.parallel(&add_one/1, size: 10) |> Situ.map(&Enum.sum/1)
    end)
  end

  # The same test with a separate pipeline for each branch.
  defp processes(scale) do
    n = max(1, round(10_000 * scale))

    run("parallel_processes10", n, Delivery.unlimited(), Enum.to_list(0..9), fn stream ->
      stream |> Situ.parallel(&add_one/1, size: 10, branches: :processes) |> Situ.map(&Enum.sum/1)
    end)
  end

  # Maps, like the reference's sparse parallel.
  defp processes_of_maps(scale) do
    n = max(1, round(10_000 * scale))
    map = Map.new(0..9, &{&1, &1})

    run("parallel_processes_maps10", n, Delivery.unlimited(), map, fn stream ->
      stream
      |> Situ.parallel(&add_one/1, of: :maps, branches: :processes)
      |> Situ.map(&Enum.sum(Map.values(&1)))
    end)
  end

  defp add_one(branch), do: Situ.map(branch, &(&1 + 1))

  defp run(metric, n, policy, parts, build) do
    counter = :counters.new(2, [])

    Situ.Bench.measure(metric, n, "msg/s", fn ->
      {:ok, _} =
        Situ.Pipeline.run(
          fn p ->
            p
            |> Situ.repeat(parts, every: 1_000, count: n)
            |> build.()
            |> Situ.each(fn sum ->
              :counters.add(counter, 1, 1)
              :counters.add(counter, 2, sum)
            end)
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max], default_policy: policy]
        )

      if {:counters.get(counter, 1), :counters.get(counter, 2)} != {n, n * 55},
        do: raise("#{:counters.get(counter, 1)} of #{n} messages")

      []
    end)
  end

  # The first message starts every branch, each with a running sum. The others contain ten keys
  # each.
  defp many(scale) do
    keys = max(100, round(100_000 * scale))
    n = max(100, round(100_000 * scale))
    before = Situ.Bench.rss_mib()
    start = :erlang.monotonic_time(:nanosecond)
    marks = :atomics.new(2, signed: true)

    metrics =
      Situ.Bench.measure("parallel_100k", n, "msg/s", fn ->
        {:ok, _} =
          Situ.Pipeline.run(
            fn p ->
              first = Map.new(1..keys, &{&1, 1})

              rest = Stream.map(1..n, fn i -> Map.new(0..9, &{rem(i * 10 + &1, keys) + 1, 1}) end)

              Situ.from_enumerable(p, Stream.concat([first], rest), every: 1_000)
              |> Situ.parallel(fn _key, branch -> Situ.sum(branch) end,
                of: :maps,
                until: :never,
                only_present: true
              )
              |> Situ.each(fn sums ->
                if map_size(sums) == keys,
                  do: :atomics.put(marks, 1, :erlang.monotonic_time(:nanosecond)),
                  else: :atomics.add(marks, 2, map_size(sums))
              end)
            end,
            pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
          )

        if :atomics.get(marks, 2) != n * 10, do: raise("#{:atomics.get(marks, 2)} parts")

        []
      end)

    started = (:atomics.get(marks, 1) - start) / 1.0e9

    metrics ++
      [
        {"parallel_100k_start", keys / started, "branches/s"},
        {"parallel_100k_rss", Situ.Bench.peak_rss_mib() - before, "MiB"}
      ]
  end
end
