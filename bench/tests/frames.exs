defmodule Situ.Bench.Frames do
  @moduledoc false
  # 1,500 frames of 640 x 480 x 3 bytes through five maps. Eight frames are created before the
  # clock starts and sent in turn, so the test measures their transport and not their creation.
  import Situ.Bench, only: [measure: 4]
  alias Situ.{Delivery, Pipeline}

  @bytes 921_600

  defmodule Source do
    @moduledoc false
    use Situ.Component,
      outputs: [out: :binary],
      options: [frames: [type: :any], count: [type: :pos_integer]]

    @impl true
    def init(opts), do: {:ok, {opts[:frames], 0, opts[:count]}}

    @impl true
    def handle_demand(n, context, {frames, next, count}) do
      last = min(next + n, count)

      actions =
        for i <- next..(last - 1)//1 do
          {:out, context.start_time + i, elem(frames, rem(i, tuple_size(frames)))}
        end

      done = if last == count, do: [{:complete, context.start_time + count}], else: []
      {actions ++ done, {frames, last, count}}
    end
  end

  def tests do
    for {name, policy} <- [
          unlimited: Delivery.unlimited(),
          throttle: Delivery.throttle(),
          sync: Delivery.synchronous()
        ],
        {kind, async} <- [{"", false}, {"-async", true}] do
      {"frames-bytes-#{name}#{kind}",
       &frames(
         "frames5_bytes_#{name}#{String.replace(kind, "-", "_")}",
         max(round(1_500 * &1), 8),
         policy,
         async
       )}
    end
  end

  defp frames(metric, n, policy, async) do
    frames = List.to_tuple(for i <- 1..8, do: :binary.copy(<<i>>, @bytes))
    seen = :counters.new(3, [])
    sums = for frame <- Tuple.to_list(frames), do: read(frame)
    expected = for i <- 0..(n - 1), reduce: 0, do: (sum -> sum + Enum.at(sums, rem(i, 8)))

    measure(metric, n, "frame/s", fn ->
      {:ok, _} =
        Pipeline.run(
          fn p ->
            1..5
            |> Enum.reduce(Situ.source(p, Source, frames: frames, count: n), fn _, stream ->
              Situ.map(stream, fn <<_, _::binary>> = frame -> frame end, async: async)
            end)
            |> Situ.each(fn frame ->
              :counters.add(seen, 1, 1)
              :counters.add(seen, 2, byte_size(frame))
              :counters.add(seen, 3, read(frame))
            end)
          end,
          pipeline: [default_policy: policy]
        )

      if :counters.get(seen, 1) != n or :counters.get(seen, 2) != n * @bytes,
        do: raise("frames are missing")

      if :counters.get(seen, 3) != expected, do: raise("frames hold something else")
    end)
  end

  # A reader touches one byte of every page.
  defp read(frame), do: read(frame, 0, 0)
  defp read(frame, at, sum) when at >= byte_size(frame), do: sum
  defp read(frame, at, sum), do: read(frame, at + 4_096, sum + :binary.at(frame, at))
end
