defmodule Situ.Bench.GenStage do
  @moduledoc false
  # Events from a GenStage producer through a pipeline, and messages of a pipeline to a GenStage
  # consumer, at full speed and in real time. The peers implement GenStage's protocol: a demand
  # dispatcher's replies, and a consumer that requests half its window.
  import Situ.Bench, only: [measure: 4]
  alias Situ.{GenStage, Pipeline, Time}

  defmodule Producer do
    @moduledoc false
    use GenServer

    @impl true
    def init(limit), do: {:ok, {0, limit}}

    @impl true
    def handle_info({:"$gen_producer", {pid, ref}, {:ask, n}}, {next, limit}) do
      last = min(next + n, limit)
      events = Enum.to_list(next..(last - 1)//1)
      if events != [], do: send(pid, {:"$gen_consumer", {self(), ref}, events})
      if last == limit, do: send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, :normal}})
      {:noreply, {last, limit}}
    end

    def handle_info(_other, state), do: {:noreply, state}
  end

  @settings [
    {"replay", [replay: [interval: {0, :unbounded}, speed: :max]]},
    {"live", []}
  ]

  def tests do
    for {name, settings} <- @settings, {way, run} <- [{"in", &into/3}, {"out", &out_of/3}] do
      {"genstage-#{way}-#{name}",
       &run.("genstage_#{way}_#{name}", max(round(300_000 * &1), 1_000), settings)}
    end
  end

  defp into(metric, n, settings) do
    {:ok, producer} = GenServer.start(Producer, n)
    seen = :counters.new(2, [])

    measure(metric, n, "event/s", fn ->
      {:ok, _} =
        Pipeline.run(
          fn p ->
            p
            |> GenStage.from(producer)
            |> Situ.each(fn v ->
              :counters.add(seen, 1, 1)
              :counters.add(seen, 2, v)
            end)
          end,
          pipeline: settings
        )

      GenServer.stop(producer)
      check(:counters.get(seen, 1), :counters.get(seen, 2), n)
    end)
  end

  defp out_of(metric, n, settings) do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(0..(n - 1)//1, every: Time.ticks(1))
          |> GenStage.accumulate(name: "Out")
        end,
        pipeline: settings
      )

    {:ok, {pid, opts}} = GenStage.subscription(p, "Out")

    measure(metric, n, "event/s", fn ->
      ref = Process.monitor(pid)
      send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, [max_demand: 1_000] ++ opts}})
      send(pid, {:"$gen_producer", {self(), ref}, {:ask, 1_000}})
      GenServer.cast(pid, {:"$demand", :forward})
      {count, sum} = consume(pid, ref, 0, 0, 0)
      Process.demonitor(ref, [:flush])
      {:ok, _} = Pipeline.await(p, 60_000)
      check(count, sum, n)
    end)
  end

  defp consume(pid, ref, pending, count, sum) when pending >= 500 do
    send(pid, {:"$gen_producer", {self(), ref}, {:ask, pending}})
    consume(pid, ref, 0, count, sum)
  end

  defp consume(pid, ref, pending, count, sum) do
    receive do
      {:"$gen_consumer", {^pid, ^ref}, {:cancel, _reason}} ->
        {count, sum}

      {:"$gen_consumer", {^pid, ^ref}, events} ->
        n = length(events)
        sum = Enum.reduce(events, sum, &(&1.data + &2))
        consume(pid, ref, pending + n, count + n, sum)
    end
  end

  defp check(count, sum, n) do
    if {count, sum} != {n, div(n * (n - 1), 2)}, do: raise("#{count} of #{n} events, sum #{sum}")
    []
  end
end
