defmodule Situ.Bench.Steady do
  @moduledoc """
  `steady-720p`: 30 newly created images of 1280 x 720 per second in real time, through resize and
  gray into a store, for ten minutes at scale 1. Prints the VM's resident memory after a fifth of
  the time and at the end, the lost images, and the latency from the image's time to the last
  operator.

  The store takes 57,600 bytes per image (1 GB at scale 1) in `SITU_BENCH_DIR`, and is deleted
  afterwards.
  """
  alias Situ.{Bench, Image, ImageOps, Pipeline, Store, Time, ImageStream}

  @rate 30

  def tests, do: [{"steady-720p", &steady/1}]

  defp steady(scale) do
    frames = max(round(600 * @rate * scale), @rate)

    root =
      Path.join(
        System.get_env("SITU_BENCH_DIR") || System.tmp_dir!(),
        "situ-steady-#{System.pid()}"
      )

    latencies = :ets.new(:steady, [:public, :set, write_concurrency: true])
    memory = :counters.new(1, [])

    try do
      {:ok, _} =
        Pipeline.run(&build(&1, frames, {latencies, memory}, root),
          pipeline: [replay: [speed: 1.0]]
        )

      stored = stored(root)
      if stored != frames, do: raise("#{stored} of #{frames} pictures were stored")
      report(latencies, memory, frames)
    after
      :ets.delete(latencies)
      File.rm_rf!(root)
    end
  end

  defp build(p, frames, {latencies, memory}, root) do
    store = Store.create(p, "Steady", root)

    p
    |> Situ.sequence(noise(), &ImageOps.invert!/1,
      every: div(Time.s(1), @rate),
      count: frames,
      type: Image
    )
    |> ImageStream.resize(320, 180)
    |> ImageStream.convert(:gray8)
    |> Situ.each(fn _image, message ->
      now = Pipeline.now(p)
      :ets.insert(latencies, {message.sequence_id, now - message.originating_time})
      if message.sequence_id == div(frames, 5), do: :counters.put(memory, 1, rss_kib())
    end)
    |> Store.write(store, "Pictures")
  end

  defp rss_kib, do: round(Bench.rss_mib() * 1024)

  defp stored(root) do
    {:ok, store} = root |> Path.join("Steady") |> Store.open()
    Enum.find(Store.streams(store), &(&1.name == "Pictures")).count
  end

  defp noise do
    data = :binary.copy(:rand.bytes(1280 * 3), 720)
    Image.new!(width: 1280, height: 720, format: :bgr24, data: data)
  end

  defp report(latencies, memory, frames) do
    {fifth, last} = {:counters.get(memory, 1) / 1024, Bench.rss_mib()}
    if last > fifth * 1.25 + 64, do: raise("memory grew from #{fifth} to #{last} MiB")
    sorted = latencies |> :ets.tab2list() |> Enum.map(&(elem(&1, 1) / 1.0e6)) |> Enum.sort()

    [
      {"steady_720p_rss_fifth", fifth, "MiB"},
      {"steady_720p_rss_end", last, "MiB"},
      {"steady_720p_lost", frames - length(sorted), "pictures"},
      {"steady_720p_latency_p50", at(sorted, 0.5), "ms"},
      {"steady_720p_latency_p99", at(sorted, 0.99), "ms"}
    ]
  end

  defp at(sorted, q), do: Enum.at(sorted, min(floor(length(sorted) * q), length(sorted) - 1))
end
