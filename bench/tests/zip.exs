defmodule Situ.Bench.Zip do
  # Zips two streams of 300,000 messages with the same times.

  def tests, do: [{"zip-unlimited", &run/1}]

  defp run(scale) do
    n = max(1, round(300_000 * scale))
    counter = :counters.new(2, [])

    Situ.Bench.measure("zip2_unlimited", n, "msg/s", fn ->
      {:ok, _} =
        Situ.Pipeline.run(
          fn p ->
            Situ.from_enumerable(p, 0..(n - 1)//1, every: 1_000)
            |> Situ.zip(Situ.from_enumerable(p, 0..(n - 1)//1, every: 1_000))
            |> Situ.each(fn [a, b] ->
              if a != b, do: raise("#{a} was zipped with #{b}")
              :counters.add(counter, 1, 1)
              :counters.add(counter, 2, a + b)
            end)
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      if {:counters.get(counter, 1), :counters.get(counter, 2)} != {n, n * (n - 1)},
        do: raise("zipped #{:counters.get(counter, 1)} of #{n}")

      []
    end)
  end
end
