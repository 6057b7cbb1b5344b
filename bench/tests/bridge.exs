defmodule Situ.Bench.Bridge do
  @moduledoc false
  # The cost of a message from one pipeline through a transport on this machine to another
  # pipeline: both ends in one VM, maps of two numbers; with `-large`, images of 1280 x 720, 2.8
  # MB. `bridge-zeromq-python` sends the same messages as JSON with pyzmq between two processes
  # (`SITU_BENCH_PYTHON` with pyzmq installed; otherwise it is skipped). `bridge-mcap` converts a
  # recording of 100 topics to MCAP and back. `bridge-parquet` and `bridge-arrow` convert integers
  # to a table and back.
  alias Situ.{Bridge, Pipeline, Store}

  def tests do
    [
      {"bridge-zeromq", &through("bridge_zeromq", Bridge.ZeroMQ, &1)},
      {"bridge-zeromq-python", &python/1},
      {"bridge-tcp", &through("bridge_tcp", Bridge.Tcp, &1)},
      {"bridge-websocket", &through("bridge_websocket", Bridge.WebSocket, &1)},
      {"bridge-zeromq-large", &large("bridge_zeromq_large", Bridge.ZeroMQ, &1)},
      {"bridge-tcp-large", &large("bridge_tcp_large", Bridge.Tcp, &1)},
      {"bridge-websocket-large", &large("bridge_websocket_large", Bridge.WebSocket, &1)},
      {"bridge-mcap", &mcap/1},
      {"bridge-parquet", &table("bridge_parquet", Bridge.Parquet, "s.parquet", &1)},
      {"bridge-arrow", &table("bridge_arrow", Bridge.Arrow, "s.arrow", &1)}
    ]
  end

  defp through(metric, module, scale) do
    n = max(1, round(50_000 * scale))
    values = Stream.map(1..n, &{&1 * 1_000, %{"n" => &1, "x" => &1 / 3}})
    through(metric, module, {n, values, &(&1["n"] == n)}, [])
  end

  defp large(metric, module, scale) do
    n = max(1, round(200 * scale))
    picture = :crypto.strong_rand_bytes(1_280 * 720 * 3)
    values = Stream.map(1..n, &{&1 * 1_000, <<&1::32, picture::binary>>})
    through(metric, module, {n, values, &match?(<<^n::32, _::binary>>, &1)}, format: :raw)
  end

  defp through(metric, module, {n, values, last?}, opts) do
    me = self()
    common = [wait_for: 1, listening: me, high_water_mark: 2 * n, linger: 60_000] ++ opts

    Situ.Bench.measure(metric, n, fn ->
      {:ok, sender} =
        Pipeline.start_link(fn p -> p |> Situ.from_enumerable(values) |> out(module, common) end)

      port =
        receive(do: ({:listening, port} -> port), after: (60_000 -> raise("it does not listen")))

      {:ok, receiver} =
        Pipeline.start_link(fn p ->
          p |> into(module, port, opts) |> Situ.each(&if(last?.(&1), do: send(me, :last)))
        end)

      receive(do: (:last -> :ok), after: (600_000 -> raise("the last message did not come")))
      Pipeline.stop(sender)
      Pipeline.stop(receiver)
      []
    end)
  end

  defp out(stream, Bridge.ZeroMQ, opts),
    do: Bridge.ZeroMQ.publish(stream, "tcp://127.0.0.1:0", [topic: "b"] ++ opts)

  defp out(stream, module, opts), do: module.serve(stream, 0, opts)

  defp into(p, Bridge.ZeroMQ, port, opts) do
    given = [topic: "b", high_water_mark: 100_000] ++ opts
    Bridge.ZeroMQ.subscribe(p, "tcp://127.0.0.1:#{port}", given)
  end

  defp into(p, module, port, opts), do: module.connect(p, "127.0.0.1", port, opts)

  defp python(scale) do
    case Situ.Bench.python("zeromq.py", ["#{max(1, round(50_000 * scale))}"]) do
      {:ok, [rate, cpu]} ->
        [{"bridge_zeromq_python", rate, "msg/s"}, {"bridge_zeromq_python_cpu", cpu, "us/msg"}]

      :error ->
        []
    end
  end

  defp mcap(scale) do
    in_folder(fn root ->
      n = max(1, round(1_000 * scale))
      topics = 100

      {:ok, _} =
        Pipeline.run(fn p ->
          store = Store.create(p, "bench", root)

          for topic <- 1..topics do
            values = Stream.map(1..n, &{&1 * 1_000, %{"n" => &1, "topic" => topic}})
            p |> Situ.from_enumerable(values) |> Store.write(store, "topic #{topic}")
          end
        end)

      store = Store.open!(Path.join(root, "bench"))
      path = Path.join(root, "bench.mcap")
      all = n * topics

      written =
        Situ.Bench.measure("bridge_mcap_write", all, fn ->
          {:ok, ^all} = Bridge.Mcap.export(store, path)
        end)

      read =
        Situ.Bench.measure("bridge_mcap_read", all, fn ->
          file = Store.open!(path)

          counts =
            for info <- Store.streams(file), do: Enum.count(Store.messages(file, info.name))

          ^all = Enum.sum(counts)
          []
        end)

      written ++ read
    end)
  end

  defp table(metric, module, file, scale) do
    in_folder(fn root ->
      n = max(1, round(200_000 * scale))

      {:ok, _} =
        Pipeline.run(fn p ->
          store = Store.create(p, "bench", root)

          p
          |> Situ.from_enumerable(Stream.map(1..n, &{&1, &1}), type: :integer)
          |> Store.write(store, "s")
        end)

      store = Store.open!(Path.join(root, "bench"))

      written =
        Situ.Bench.measure(metric <> "_write", n, "rows/s", fn ->
          {:ok, %{"s" => ^n}} = module.export(store, root)
          []
        end)

      read =
        Situ.Bench.measure(metric <> "_read", n, "rows/s", fn ->
          ^n = Enum.count(module.messages(Path.join(root, file)))
          []
        end)

      written ++ read
    end)
  end

  defp in_folder(fun) do
    root = Path.join(System.tmp_dir!(), "situ-bench-bridge-#{System.pid()}")
    File.rm_rf!(root)
    File.mkdir_p!(root)
    fun.(root)
  after
    File.rm_rf!(Path.join(System.tmp_dir!(), "situ-bench-bridge-#{System.pid()}"))
  end
end
