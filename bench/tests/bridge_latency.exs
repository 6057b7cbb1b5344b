Code.require_file("latency.exs", __DIR__)

defmodule Situ.Bench.BridgeLatency do
  @moduledoc false
  # The latency of a message at 1,000 per second, from a source in one pipeline through a
  # transport on this machine to a sink in another. Messages are numbers, and both ends are in one
  # VM. `bridge-latency-zeromq-python` measures pyzmq with JSON between two processes
  # (`SITU_BENCH_PYTHON` with pyzmq installed; otherwise it is skipped).
  alias Situ.Bench.Latency.Metronome
  alias Situ.{Bridge, Pipeline}

  @transports [zeromq: Bridge.ZeroMQ, tcp: Bridge.Tcp, websocket: Bridge.WebSocket]

  def tests do
    for({name, module} <- @transports, do: {"bridge-latency-#{name}", &latency(name, module, &1)}) ++
      [{"bridge-latency-zeromq-python", &python/1}]
  end

  defp latency(name, module, scale) do
    n = max(100, round(3_000 * scale))
    me = self()
    common = [wait_for: 1, listening: me, linger: 10_000]

    # The pipeline uses the machine's clock, because the source ticks in real time.
    {:ok, sender} =
      Pipeline.start_link(fn p ->
        p |> Situ.source(Metronome, count: n) |> out(module, common)
      end)

    port =
      receive(do: ({:listening, port} -> port), after: (60_000 -> raise("it does not listen")))

    {:ok, receiver} =
      Pipeline.start_link(fn p ->
        p |> into(module, port) |> Situ.each(&send(me, {:took, :erlang.monotonic_time() - &1}))
      end)

    # The first messages wait for the connection.
    times =
      for _ <- 1..n,
          do: receive(do: ({:took, t} -> t), after: (30_000 -> raise("a message is lost")))

    Pipeline.stop(sender)
    Pipeline.stop(receiver)
    result("bridge_latency_#{name}", times |> Enum.drop(div(n, 10)) |> Enum.map(&(&1 / 1_000)))
  end

  defp result(metric, times) do
    sorted = times |> Enum.sort() |> List.to_tuple()
    at = fn share -> elem(sorted, floor(share * (tuple_size(sorted) - 1))) end
    [{metric <> "_p50", at.(0.5), "us"}, {metric <> "_p99", at.(0.99), "us"}]
  end

  defp out(stream, Bridge.ZeroMQ, opts),
    do: Bridge.ZeroMQ.publish(stream, "tcp://127.0.0.1:0", [topic: "b"] ++ opts)

  defp out(stream, module, opts), do: module.serve(stream, 0, opts)

  defp into(p, Bridge.ZeroMQ, port),
    do: Bridge.ZeroMQ.subscribe(p, "tcp://127.0.0.1:#{port}", topic: "b")

  defp into(p, module, port), do: module.connect(p, "127.0.0.1", port)

  defp python(scale) do
    n = max(100, round(3_000 * scale))

    case Situ.Bench.python("zeromq.py", ["#{n}", "latency"]) do
      {:ok, [p50, p99]} ->
        [
          {"bridge_latency_zeromq_python_p50", p50, "us"},
          {"bridge_latency_zeromq_python_p99", p99, "us"}
        ]

      :error ->
        []
    end
  end
end
