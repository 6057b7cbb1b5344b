defmodule Situ.Bench.Fanout do
  @moduledoc false
  # One range to ten sinks in separate processes; `throttle` with a queue of one before each.
  import Situ.Bench, only: [measure: 3]
  alias Situ.{Delivery, Pipeline, Time}

  @policies [
    unlimited: Delivery.unlimited(),
    throttle: Delivery.throttle(1),
    sync: Delivery.synchronous()
  ]

  def tests do
    for {name, policy} <- @policies,
        do: {"fanout-#{name}", &fanout("fanout10_#{name}", round(200_000 * &1), policy)}
  end

  defp fanout(metric, n, policy) do
    counts = :counters.new(10, [])

    measure(metric, n, fn ->
      {:ok, _} =
        Pipeline.run(
          fn p ->
            stream = Situ.from_enumerable(p, 0..(n - 1)//1, every: Time.ticks(1))

            for i <- 1..10,
                do: Situ.each(stream, fn _ -> :counters.add(counts, i, 1) end, policy: policy)
          end,
          pipeline: [replay: [speed: :max]]
        )

      for i <- 1..10,
          :counters.get(counts, i) != n,
          do: raise("sink #{i} got #{:counters.get(counts, i)} of #{n}")
    end)
  end
end
