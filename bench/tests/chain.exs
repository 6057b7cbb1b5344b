defmodule Situ.Bench.Chain do
  @moduledoc false
  # Sends a range with steps of one tick through k maps that add one, and counts the messages at
  # the end. `unlimited` and `sync` are the defaults: light operators in one process. `throttle`
  # requests a queue of one before each map (Throttle in the reference), which a single process
  # implies. `async` has a process and an envelope for each.
  import Situ.Bench, only: [measure: 3]
  alias Situ.{Delivery, Pipeline, Time}

  @policies [unlimited: Delivery.unlimited(), sync: Delivery.synchronous()]
  @sizes [{1, 600_000}, {10, 200_000}, {50, 60_000}]

  def tests do
    plain =
      for {k, n} <- @sizes, {name, policy} <- @policies do
        {"chain-#{k}-#{name}", &chain("chain_k#{k}_#{name}", k, round(n * &1), policy, [])}
      end

    plain ++
      [
        {"chain-10-async",
         &chain("chain_k10_async", 10, round(200_000 * &1), Delivery.unlimited(), async: true)},
        {"chain-10-throttle-async",
         &chain("chain_k10_throttle_async", 10, round(200_000 * &1), Delivery.unlimited(),
           async: true,
           policy: Delivery.throttle(1)
         )}
      ] ++
      for {k, n} <- [{1, 600_000}, {10, 200_000}] do
        {"chain-#{k}-throttle",
         &chain("chain_k#{k}_throttle", k, round(n * &1), Delivery.unlimited(),
           policy: Delivery.throttle(1)
         )}
      end
  end

  defp chain(metric, k, n, policy, opts) do
    sum = :counters.new(2, [])

    measure(metric, n, fn ->
      {:ok, _} =
        Pipeline.run(
          fn p ->
            1..k
            |> Enum.reduce(Situ.from_enumerable(p, 0..(n - 1)//1, every: Time.ticks(1)), fn _,
                                                                                            stream ->
              Situ.map(stream, &(&1 + 1), opts)
            end)
            |> Situ.each(fn v ->
              :counters.add(sum, 1, 1)
              :counters.add(sum, 2, v)
            end)
          end,
          pipeline: [default_policy: policy]
        )

      check!(:counters.get(sum, 1) == n, "#{:counters.get(sum, 1)} of #{n} messages came through")
      check!(:counters.get(sum, 2) == div(n * (n - 1), 2) + k * n, "wrong sum")
    end)
  end

  defp check!(true, _why), do: :ok
  defp check!(false, why), do: raise(why)
end
