defmodule Situ.SamplingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Message, Pipeline, Reproducible, Sampling}

  doctest Sampling

  defp messages(timed), do: for({t, v} <- timed, do: %Message{originating_time: t, data: v})

  defp all({outputs, sampling}) do
    if Sampling.more_ticks?(sampling) do
      {more, sampling} = all(Sampling.next_ticks(sampling))
      {outputs ++ more, sampling}
    else
      {outputs, sampling}
    end
  end

  property "splitting into batches and time slices changes nothing" do
    forall {stream, cut, interval} <-
             {timed_values(integer(), 400), integer(0, 20), integer(1, 7)} do
      messages = messages(stream)
      new = Sampling.new(Reproducible.nearest(), interval, 0)

      end_of = fn {outputs, sampling} ->
        {last, _} = all(Sampling.close(sampling, 5_000))
        outputs ++ last
      end

      whole = end_of.(all(Sampling.push(new, messages)))
      {first, second} = Enum.split(messages, cut)
      {outputs, sampling} = all(Sampling.push(new, first))
      {more, sampling} = all(Sampling.push(sampling, second))
      assert end_of.({outputs ++ more, sampling}) == whole
    end
  end

  for {name, build} <- [
        sample: quote(do: &Situ.sample(&1, 1_000_000)),
        lowpass: quote(do: &Situ.lowpass(&1, rate: 1_000, cutoff: 10))
      ] do
    test "#{name} fills a gap of one minute at 1 ms only as fast as its consumer requests" do
      gap = Situ.Time.s(60)
      most = :atomics.new(1, [])
      count = :counters.new(1, [])
      build = unquote(build)

      look = fn _data ->
        :counters.add(count, 1, 1)

        if rem(:counters.get(count, 1), 5_000) == 0 do
          words = for pid <- Process.get(:linked), do: words(pid)
          :atomics.put(most, 1, max(:atomics.get(most, 1), Enum.max(words)))
        end
      end

      {:ok, _} =
        Pipeline.run(
          fn p ->
            p
            |> Situ.from_enumerable([{0, 1}, {gap, 2}])
            |> build.()
            |> Situ.each(
              fn data ->
                if Process.get(:linked) == nil, do: Process.put(:linked, neighbours())
                look.(data)
              end,
              async: true,
              policy: Situ.Delivery.throttle(10)
            )
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      assert :counters.get(count, 1) == 60_001
      # Emitting all ticks together would take 60,000 messages of about 15 words each.
      assert :atomics.get(most, 1) < 400_000
    end
  end

  # Returns the other stages of the pipeline, found through the links of its process.
  defp neighbours do
    server = Process.get(:situ_pipeline)
    {:links, links} = Process.info(server, :links)
    for pid <- links, is_pid(pid), do: pid
  end

  defp words(pid) do
    case Process.info(pid, :total_heap_size) do
      {:total_heap_size, words} -> words
      nil -> 0
    end
  end
end
