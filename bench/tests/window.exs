defmodule Situ.Bench.Window do
  # 500,000 messages, each with a list of the last 10.

  alias Situ.Delivery

  @policies [
    {"unlimited", &Delivery.unlimited/0},
    {"throttle", &Delivery.throttle/0},
    {"sync", &Delivery.synchronous/0}
  ]

  def tests do
    for {name, policy} <- @policies, do: {"window-" <> name, &run(name, policy.(), &1)}
  end

  defp run(name, policy, scale) do
    n = max(10, round(500_000 * scale))
    counter = :counters.new(2, [])

    Situ.Bench.measure("window10_" <> name, n, "msg/s", fn ->
      {:ok, _} =
        Situ.Pipeline.run(
          fn p ->
            Situ.from_enumerable(p, 0..(n - 1)//1, every: 100)
            |> Situ.window(-9..0)
            |> Situ.each(fn [first | _] = window ->
              if length(window) != 10 or List.last(window) != first + 9,
                do: raise("a window of #{length(window)} from #{first}")

              :counters.add(counter, 1, 1)
              :counters.add(counter, 2, first)
            end)
          end,
          pipeline: [
            replay: [interval: {0, :unbounded}, speed: :max],
            default_policy: policy
          ]
        )

      windows = n - 9

      if {:counters.get(counter, 1), :counters.get(counter, 2)} !=
           {windows, div(windows * (windows - 1), 2)},
         do: raise("#{:counters.get(counter, 1)} windows of #{windows}")

      []
    end)
  end
end
