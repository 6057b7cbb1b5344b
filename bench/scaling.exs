# Models many sites with many streams that send to one hub: where the bottleneck is, and how far
# it can be moved. `elixir bench/scaling.exs` prints the tables in docs/scaling.md. The parameters
# were measured with the named benchmarks (`bin/bench`). Replace them by those of your machines.
defmodule Scaling do
  # One site: 50 streams. Rates in messages per second, sizes in bytes (a compressed image, 20 ms
  # of audio, a reading).
  @streams [
    %{name: "readings", count: 40, rate: 100, size: 60},
    %{name: "sound", count: 6, rate: 50, size: 640},
    %{name: "pictures", count: 4, rate: 15, size: 25_000}
  ]

  @chunk_bytes 64 * 1024
  @chunk_s 0.02

  # Measured on two shared cores. A hub with more cores has a multiple of it.
  @measured %{
    # log-nats: one server, one replica, acknowledged. Chunks per second of one writer, and bytes
    # per second.
    append_s: 1 / 920,
    disk_bytes: 149.0e6,
    # log-nats: CPU time of nats-server per chunk, and per byte.
    chunk_cpu_s: 30.0e-6,
    byte_cpu_s: 0.9e-9,
    # link-tcp: CPU time of both sides per message, half of it on the hub. Memory of
    # link-10000-streams, bytes per stream.
    link_message_cpu_s: 0.38e-6,
    stream_memory: 4_600,
    connection_memory: 120_000
  }

  @hub %{cores: 16, disk_bytes: 800.0e6, network_bytes: 1.2e9, memory: 32.0e9, files: 65_536}
  @uplink %{bytes: 6.0e6, rtt_s: 0.03}

  def main do
    IO.puts("chunks of #{round(@chunk_s * 1_000)} ms, as a writer makes them by default")
    table(@chunk_s)
    IO.puts("\nchunks of 1 s")
    table(1.0)
    IO.puts("\nan outage of the hub of 10 minutes, 1,000 sites, chunks of 1 s")
    outage(1_000, 1.0, 600)
  end

  defp table(chunk_s) do
    IO.puts(
      "sites  streams  MB/s  chunks/s  uplink  rtt    net    disk   log CPU  link CPU  memory  breaks first"
    )

    for sites <- [1, 10, 50, 100, 250, 500, 1_000] do
      use = uses(sites, chunk_s)
      {name, most} = Enum.max_by(use.parts, &elem(&1, 1))

      first =
        if most > 1, do: "#{name} (#{percent(most)})", else: "nothing (#{name} #{percent(most)})"

      row = [
        pad(sites, 5),
        pad(sites * 50, 8),
        pad(round(use.bytes / 1.0e6), 5),
        pad(round(use.chunks), 9)
      ]

      parts = for {_, part} <- use.parts, do: pad(percent(part), 7)
      IO.puts(Enum.join(row ++ parts ++ [first], " "))
    end
  end

  @doc "Returns the utilization of each resource, 1 being full."
  def uses(sites, chunk_s) do
    per_site = site(chunk_s)
    chunks = per_site.chunks * sites
    bytes = per_site.bytes * sites
    m = @measured

    %{
      chunks: chunks,
      bytes: bytes,
      parts: [
        {"uplink of a site", per_site.bytes / @uplink.bytes},
        # One chunk of a stream is in flight at a time, so the round trip limits their number.
        {"round trip", per_site.most_chunks * (@uplink.rtt_s + m.append_s)},
        {"hub network", bytes / @hub.network_bytes},
        {"hub disk", bytes / @hub.disk_bytes},
        {"hub CPU, log", (chunks * m.chunk_cpu_s + bytes * m.byte_cpu_s) / @hub.cores},
        {"hub CPU, links", per_site.messages * sites * m.link_message_cpu_s / @hub.cores},
        {"hub memory", sites * (m.connection_memory + 50 * m.stream_memory) / @hub.memory}
      ]
    }
  end

  defp site(chunk_s) do
    each =
      for s <- @streams do
        bytes = s.rate * (s.size + 28)
        # A chunk is sent when it is full or old, and contains at least one message.
        chunks = min(s.rate, max(1 / chunk_s, bytes / @chunk_bytes))

        %{
          bytes: bytes * s.count,
          chunks: chunks * s.count,
          most: chunks,
          messages: s.rate * s.count
        }
      end

    %{
      bytes: each |> Enum.map(& &1.bytes) |> Enum.sum(),
      chunks: each |> Enum.map(& &1.chunks) |> Enum.sum(),
      messages: each |> Enum.map(& &1.messages) |> Enum.sum(),
      most_chunks: each |> Enum.map(& &1.most) |> Enum.max()
    }
  end

  # In each second, every site keeps messages that it could not send in its own store, and the hub
  # receives the others.
  defp outage(sites, chunk_s, outage_s) do
    one = site(chunk_s)
    fresh = one.bytes * sites
    hub = min(hub_bytes(one), sites * @uplink.bytes)

    {seconds, peak} = catch_up(0, fresh * outage_s, fresh, hub)
    IO.puts("  kept by each site meanwhile: #{round(one.bytes * outage_s / 1.0e6)} MB")

    IO.puts(
      "  the hub takes #{round(hub / 1.0e6)} MB/s, #{round(fresh / 1.0e6)} MB/s of which are new"
    )

    if seconds,
      do:
        IO.puts(
          "  caught up after #{seconds} s; the most that waited: #{round(peak / 1.0e9)} GB in all"
        ),
      else: IO.puts("  never caught up: what is new is more than the hub takes")
  end

  defp catch_up(seconds, 0, _fresh, _hub), do: {seconds, 0}
  defp catch_up(_seconds, waiting, fresh, hub) when hub <= fresh, do: {nil, waiting}
  defp catch_up(seconds, waiting, fresh, hub), do: drain(seconds, waiting, fresh, hub, waiting)

  defp drain(seconds, waiting, _fresh, _hub, peak) when waiting <= 0, do: {seconds, peak}

  defp drain(seconds, waiting, fresh, hub, peak),
    do: drain(seconds + 1, waiting + fresh - hub, fresh, hub, max(peak, waiting))

  # Chunks are full while a site catches up.
  defp hub_bytes(_one) do
    by_cpu = @hub.cores / (@measured.chunk_cpu_s / @chunk_bytes + @measured.byte_cpu_s)
    Enum.min([@hub.disk_bytes, @hub.network_bytes, by_cpu])
  end

  defp percent(part), do: "#{Float.round(part * 100, if(part < 0.1, do: 1, else: 0)) |> trim()}%"
  defp trim(number), do: number |> to_string() |> String.replace_suffix(".0", "")
  defp pad(value, width), do: value |> to_string() |> String.pad_leading(width)
end

Scaling.main()
