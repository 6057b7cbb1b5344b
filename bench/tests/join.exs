defmodule Situ.Bench.Join do
  # Joins two streams of 1,000,000 messages, 1 ms apart: exact (with the same times), or nearest
  # (with the secondary 0.3 ms later and a tolerance of 5 ms). Every joined message counts once.

  @ms 1_000_000

  def tests do
    [
      {"join-exact-unlimited", &exact/1},
      {"join-nearest-unlimited", &nearest/1}
    ]
  end

  defp exact(scale), do: run("join_exact_unlimited", n(scale), 0, Situ.Reproducible.exact())

  defp nearest(scale),
    do: run("join_nearest_unlimited", n(scale), 300_000, Situ.Reproducible.nearest(5 * @ms))

  defp n(scale), do: max(1, round(1_000_000 * scale))

  defp run(metric, n, shift, interpolator) do
    counter = :counters.new(2, [])

    Situ.Bench.measure(metric, n, "joined/s", fn ->
      {:ok, _} =
        Situ.Pipeline.run(
          fn p ->
            primary = Situ.from_enumerable(p, 0..(n - 1)//1, every: @ms)

            # Both streams count from the start. Only the times are shifted.
            secondary = Situ.from_enumerable(p, 0..(n - 1)//1, every: @ms, align: shift)

            primary
            |> Situ.join(secondary, interpolator)
            |> Situ.each(fn {a, b} ->
              if a != b, do: raise("#{a} was joined with #{b}")
              :counters.add(counter, 1, 1)
              :counters.add(counter, 2, a + b)
            end)
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      check(counter, n)
      []
    end)
  end

  defp check(counter, n) do
    {count, sum} = {:counters.get(counter, 1), :counters.get(counter, 2)}
    if {count, sum} != {n, n * (n - 1)}, do: raise("joined #{count} of #{n}, sum #{sum}")
  end
end
