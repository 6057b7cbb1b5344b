defmodule Situ.Bench.Overload do
  @moduledoc false
  # A source that is five times as fast as its sink, in real time, with each policy: lost
  # messages, the age of messages on arrival, and the number of waiting messages.
  alias Situ.{Delivery, Pipeline, Time}

  @policies [
    {"unlimited", Delivery.unlimited()},
    {"throttle", Delivery.throttle()},
    {"sync", Delivery.synchronous()},
    {"latest", Delivery.latest()},
    {"max_queue", Delivery.max_queue(10)},
    {"max_latency", Delivery.max_latency(Time.ms(50))}
  ]

  @sink_us 2_000

  def tests do
    for {name, policy} <- @policies, do: {"overload-#{name}", &overload(name, policy, 3 * &1)}
  end

  defp overload(name, policy, seconds) do
    test = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.repeat(:x, every: Time.us(@sink_us / 5))
          |> Situ.each(fn _, message -> work(message, test) end, policy: policy, name: "Sink")
        end,
        []
      )

    queue = watch(p, System.monotonic_time(:millisecond) + round(seconds * 1_000), 0)
    {:ok, report} = Pipeline.stop(p)
    [edge | _] = Enum.filter(report.snapshot.edges, &(&1.to_input == "in"))
    ages = Enum.sort(ages())
    if ages == [], do: raise("nothing arrived")

    if Delivery.lossy?(policy) == false and edge.dropped > 0,
      do: raise("a lossless policy dropped #{edge.dropped}")

    [
      {"overload_#{name}_taken", length(ages) / seconds, "msg/s"},
      {"overload_#{name}_dropped", edge.dropped / seconds, "msg/s"},
      {"overload_#{name}_age_p50", at(ages, 0.5), "ms"},
      {"overload_#{name}_age_p99", at(ages, 0.99), "ms"},
      {"overload_#{name}_queue_max", queue, "msg"},
      {"overload_#{name}_rss", Situ.Bench.rss_mib(), "MiB"}
    ]
  end

  # The sink's work keeps its process busy and records the age of the message.
  defp work(message, test) do
    send(test, {:age, (Time.now() - message.originating_time) / 1.0e6})
    spin(System.monotonic_time(:microsecond) + @sink_us)
  end

  defp spin(till), do: if(System.monotonic_time(:microsecond) < till, do: spin(till), else: :ok)

  defp watch(p, till, most) do
    queue = Pipeline.info(p).edges |> Enum.map(& &1.queue) |> Enum.max()
    Process.sleep(20)

    if System.monotonic_time(:millisecond) < till,
      do: watch(p, till, max(most, queue)),
      else: max(most, queue)
  end

  defp ages do
    receive do
      {:age, ms} -> [ms | ages()]
    after
      0 -> []
    end
  end

  defp at(sorted, q), do: Enum.at(sorted, min(floor(length(sorted) * q), length(sorted) - 1))
end
