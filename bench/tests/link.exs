defmodule Situ.Bench.Link do
  # A recording is served over TCP, TLS and a Unix socket, and read by a pipeline in the same
  # virtual machine, so that the CPU time includes both sides.
  alias Situ.{Message, Link}
  alias Situ.Link.Server
  alias Situ.Store.Writer

  @small 500_000
  @large 400
  @megabyte 1024 * 1024

  def tests do
    for {kind, _} <- transports() do
      {"link-#{kind}", &messages(kind, max(1_000, round(@small * &1)))}
    end ++
      for {kind, _} <- transports() do
        {"link-#{kind}-1mb", &pictures(kind, max(8, round(@large * &1)))}
      end ++ [{"link-viewers", &viewers(max(1_000, round(20_000 * &1)))}]
  end

  defp transports, do: [tcp: [], tls: [], unix: []]

  defp messages(kind, n) do
    linked(kind, for(i <- 1..n, do: message(i, i * 0.5)), fn address, opts ->
      Situ.Bench.measure("link_#{kind}", n, fn -> ^n = taken(address, opts) end)
    end)
  end

  defp pictures(kind, n) do
    picture = :binary.copy(<<7>>, @megabyte)

    linked(kind, for(i <- 1..n, do: message(i, picture)), fn address, opts ->
      [{name, rate, _} | rest] =
        Situ.Bench.measure("link_#{kind}_1mb", n, "MB/s", fn -> ^n = taken(address, opts) end)

      [{name, rate * @megabyte / 1.0e6, "MB/s"} | rest]
    end)
  end

  # A hundred requests run concurrently, so the slowest one determines the rate.
  defp viewers(n) do
    linked(:tcp, for(i <- 1..n, do: message(i, i)), fn address, opts ->
      Situ.Bench.measure("link_100_viewers", 100 * n, fn ->
        1..100
        |> Enum.map(fn _ -> Task.async(fn -> taken(address, opts) end) end)
        |> Task.await_many(600_000)
        |> Enum.each(fn taken -> ^n = taken end)

        [{"link_100_viewers_rss", Situ.Bench.peak_rss_mib(), "MiB"}]
      end)
    end)
  end

  defp message(i, data),
    do: %Message{data: data, originating_time: i, creation_time: i, sequence_id: i}

  defp taken(address, opts) do
    counter = :counters.new(1, [])

    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          p
          |> Link.open(address, [from: :start] ++ opts)
          |> Link.stream("s")
          |> Situ.each(fn _ -> :counters.add(counter, 1, 1) end)
        end,
        pipeline: [replay: [speed: :max]]
      )

    :counters.get(counter, 1)
  end

  defp linked(kind, messages, fun) do
    root =
      Path.join(
        System.tmp_dir!(),
        "situ-bench-#{System.pid()}-#{System.unique_integer([:positive])}"
      )

    File.mkdir_p!(root)
    {:ok, _} = Application.ensure_all_started(:situ_link)
    {:ok, writer} = Writer.create("link", root)
    {:ok, stream} = Writer.stream(writer, "s")
    stream = Enum.reduce(Enum.chunk_every(messages, 512), stream, &append/2)
    {:ok, _} = Writer.close_stream(stream, length(messages))
    :ok = Writer.close(writer)
    {serving, connecting} = settings(kind, root)
    {:ok, server} = Link.serve(Path.join(root, "link"), serving)

    try do
      fun.(address(kind, server, root), connecting)
    after
      Server.close(server)
      File.rm_rf!(root)
    end
  end

  defp append(chunk, stream) do
    {:ok, stream} = Writer.append(stream, chunk)
    stream
  end

  defp settings(:tcp, _root), do: {[port: 0], []}
  defp settings(:unix, root), do: {[port: :none, unix: Path.join(root, "socket")], []}

  defp settings(:tls, _root) do
    key = [key: {:namedCurve, :secp256r1}]
    chain = %{root: key, intermediates: [], peer: key}
    made = :public_key.pkix_test_data(%{server_chain: chain, client_chain: chain})
    {[port: 0, tls: made.server_config], [tls: [verify: :verify_none]]}
  end

  defp address(:unix, _server, root), do: "situ+unix://#{root}/socket"
  defp address(:tcp, server, _root), do: "situ://127.0.0.1:#{Server.port(server)}"
  defp address(:tls, server, _root), do: "situs://127.0.0.1:#{Server.port(server)}"
end
