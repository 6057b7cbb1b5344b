defmodule Situ.MetricsTest do
  use ExUnit.Case, async: false
  use Situ.Test.Property

  alias Situ.Metrics
  alias Situ.Metrics.{LatencyHistogram, Server}
  alias Situ.Ports.Counters
  alias Situ.Test.MetricsText

  doctest Situ.Metrics

  defmodule OwnMetrics do
    @behaviour Metrics
    @impl true
    def collect_metrics,
      do: [%{name: "own_total", type: :counter, help: "Ours.", samples: [{[], 3}]}]
  end

  defmodule BrokenMetrics do
    @behaviour Metrics
    @impl true
    def collect_metrics, do: raise("no metrics today")
  end

  defmodule StuckMetrics do
    @behaviour Metrics
    @impl true
    def collect_metrics, do: GenServer.call(:no_such_process, :list)
  end

  defp start_pipeline(name) do
    {:ok, p} =
      Situ.Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(1..100, every: 1, keep_open: true, name: "Numbers")
          |> Situ.map(&(&1 * 2), name: "Double", async: true)
          |> Situ.each(& &1, name: "Sink", async: true)
        end,
        pipeline: [name: name, replay: [speed: :max]]
      )

    on_exit(fn -> Situ.Pipeline.stop(p) end)
    await_processed(name, 100)
    p
  end

  defp await_processed(name, n) do
    line =
      ~s(situ_messages_processed_total{pipeline="#{name}",from="Double.out",to="Sink.in"} #{n})

    unless Metrics.to_text(Metrics.collect()) =~ line, do: await_processed(name, n)
  end

  test "counts what the connections of a pipeline carried" do
    start_pipeline("Metrics count")
    text = Metrics.to_text(Metrics.collect())
    labels = ~s({pipeline="Metrics count",from="Double.out",to="Sink.in"})
    assert text =~ "situ_messages_emitted_total#{labels} 100\n"
    assert text =~ "situ_messages_dropped_total#{labels} 0\n"
    assert text =~ "situ_latency_seconds_count#{labels} 100\n"
    assert text =~ ~s(situ_component_errors_total{pipeline="Metrics count",component="Double"} 0)
    assert text =~ ~r/situ_vm_memory_bytes\{kind="total"\} \d+/
    metrics = MetricsText.parse!(text)
    assert {"histogram", samples} = metrics["situ_latency_seconds"]

    assert Enum.any?(
             samples,
             &match?({_, %{"pipeline" => "Metrics count", "le" => "+Inf"}, _}, &1)
           )
  end

  property "a histogram counts every latency below a limit, and never decreases" do
    forall latencies <- list({pos_integer(), one_of([integer(), integer(0, 100_000_000_000)])}) do
      ref = Counters.new()
      for {n, latency} <- latencies, do: Counters.count_processed(ref, n, latency, 0)
      samples = LatencyHistogram.to_samples(LatencyHistogram.read(ref), [])
      metric = %{name: "x_seconds", type: :histogram, help: "Latency.", samples: samples}

      assert %{"x_seconds" => {"histogram", samples}} =
               MetricsText.parse!(Metrics.to_text([metric]))

      for {"x_seconds_bucket", %{"le" => limit}, count} <- samples, limit != "+Inf" do
        ns = round(String.to_float(limit) * 1.0e9)

        assert count ==
                 latencies
                 |> Enum.filter(&(elem(&1, 1) < ns))
                 |> Enum.map(&elem(&1, 0))
                 |> Enum.sum()
      end
    end
  end

  test "pipelines of the same name have different series" do
    for _ <- 1..2, do: start_pipeline("Metrics twin")
    {_, running} = MetricsText.parse!(Metrics.to_text(Metrics.collect()))["situ_pipeline_running"]
    names = for {_, %{"pipeline" => "Metrics twin" <> _ = name}, _} <- running, do: name
    assert names == ["Metrics twin", "Metrics twin (2)"]
  end

  test "a pipeline with many connections has a bounded number of series" do
    counters = Map.new(1..700, &{&1, Counters.new()})
    for {_, ref} <- counters, do: Counters.count_processed(ref, 2, 1_000_000, 1_000)

    edges =
      for id <- 1..700,
          do: %Situ.Diagnostics.Edge{
            id: id,
            from: id,
            from_output: "out",
            to: id + 1,
            to_input: "in",
            processed: 2
          }

    nodes = for id <- 1..701, do: %Situ.Diagnostics.Node{id: id, path: "Part #{id}", errors: 1}
    snapshot = %Situ.Diagnostics.Snapshot{pipeline: "Many", nodes: nodes, edges: edges}
    metrics = Situ.Metrics.PipelineMetrics.build_metrics([{snapshot, counters}])
    metrics = MetricsText.parse!(Metrics.to_text(metrics))
    {_, processed} = metrics["situ_messages_processed_total"]
    assert length(processed) == 501
    assert {_, %{"from" => "(others)", "to" => "(others)"}, 400.0} = List.last(processed)
    {_, errors} = metrics["situ_component_errors_total"]
    assert {_, %{"component" => "(others)"}, 201.0} = List.last(errors)
    {_, latency} = metrics["situ_latency_seconds"]
    assert {"situ_latency_seconds_count", %{"from" => "(others)"}, 400.0} = List.last(latency)
  end

  test "includes metrics of applications, except metrics that raise" do
    Application.put_env(:situ, :metrics, [OwnMetrics, BrokenMetrics, StuckMetrics])
    on_exit(fn -> Application.delete_env(:situ, :metrics) end)

    log =
      ExUnit.CaptureLog.capture_log(fn ->
        assert Metrics.to_text(Metrics.collect()) =~ "own_total 3\n"
      end)

    assert log =~ "no metrics today"
    assert log =~ "StuckMetrics are left out"
  end

  property "every label survives, and every line is a comment or a sample" do
    forall {value, number} <- {binary(), integer()} do
      metric = %{name: "x", type: :gauge, help: value, samples: [{[label: value], number}]}
      text = Metrics.to_text([metric])
      assert String.valid?(text)
      assert [help, "# TYPE x gauge", sample, ""] = String.split(text, "\n")
      assert String.starts_with?(help, "# HELP x ")

      assert [_, escaped, written] =
               Regex.run(~r/\Ax\{label="((?:[^"\\]|\\.)*)"\} (\S+)\z/su, sample)

      assert String.to_integer(written) == number
      if String.valid?(value), do: assert(unescape(escaped) == value)
    end
  end

  defp unescape("\\n" <> rest), do: "\n" <> unescape(rest)
  defp unescape("\\" <> <<c::utf8, rest::binary>>), do: <<c::utf8>> <> unescape(rest)
  defp unescape(<<c::utf8, rest::binary>>), do: <<c::utf8>> <> unescape(rest)
  defp unescape(""), do: ""

  test "an invalid name is left out" do
    metric = %{name: "no spaces", type: :gauge, help: "", samples: [{[], 1}]}
    assert Metrics.to_text([metric]) == ""
  end

  describe "the server" do
    test "serves metrics and health, and nothing else" do
      start_pipeline("Metrics served")
      {:ok, server} = Server.start_link(port: 0)
      port = Server.port(server)
      assert {200, type, body} = get(port, "GET /metrics?x=1 HTTP/1.1")
      assert type =~ "text/plain; version=0.0.4"
      assert body =~ ~s(situ_pipeline_running{pipeline="Metrics served"} 1)
      assert {200, "application/json", ~s({"status":"ok"})} = get(port, "GET /health HTTP/1.1")
      assert {404, _, _} = get(port, "GET /../../etc/passwd HTTP/1.1")
      assert {405, _, _} = get(port, "POST /metrics HTTP/1.1")
      GenServer.stop(server)
      refute serves_health?(port)
    end

    # Another program may use the port by now.
    defp serves_health?(port) do
      with {:ok, socket} <- :gen_tcp.connect('127.0.0.1', port, [:binary, active: false]),
           :ok <- :gen_tcp.send(socket, "GET /health HTTP/1.1\r\n\r\n"),
           {:ok, reply} <- :gen_tcp.recv(socket, 0, 1_000),
           do: reply =~ ~s({"status"),
           else: (_ -> false)
    end

    test "reports missing and suspended pipelines" do
      p = start_pipeline("Metrics health")
      {:ok, server} = Server.start_link(port: 0)
      port = Server.port(server)
      assert {200, _, _} = get(port, "GET /health?pipeline=Metrics%20health HTTP/1.1")

      assert {503, _, body} =
               get(port, "GET /health?pipeline=Door&pipeline=Metrics+health HTTP/1.1")

      assert Situ.JSON.decode(body) ==
               {:ok, %{"status" => "unhealthy", "pipelines" => %{"Door" => "is not running"}}}

      :sys.suspend(p)
      assert {503, _, body} = get(port, "GET /health HTTP/1.1")
      assert body =~ ~s("Metrics health":"does not respond")
      :sys.resume(p)
      assert {200, _, _} = get(port, "GET /health HTTP/1.1")
      GenServer.stop(server)
    end

    test "explains a port that is used, and a wrong address" do
      {:ok, server} = Server.start_link(port: 0)
      port = Server.port(server)
      assert {:error, %{code: :port_busy, what: what}} = Server.start_link(port: port)
      assert what =~ "#{port}"
      assert {:error, %{code: :bad_address}} = Server.start_link(ip: "nowhere")
      assert {:error, %{code: :bad_option}} = Server.start_link(port: -1)
      GenServer.stop(server)
    end
  end

  defp get(port, line) do
    {:ok, socket} = :gen_tcp.connect('127.0.0.1', port, [:binary, active: false])

    :ok =
      :gen_tcp.send(
        socket,
        "#{line}\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
      )

    reply = receive_all(socket, "")
    [head, body] = String.split(reply, "\r\n\r\n", parts: 2)
    ["HTTP/1.1 " <> status | headers] = String.split(head, "\r\n")

    type =
      Enum.find_value(headers, fn header ->
        with [name, value] <- String.split(header, ":", parts: 2),
             "content-type" <- String.downcase(name),
             do: String.trim(value),
             else: (_ -> nil)
      end)

    {status |> String.slice(0, 3) |> String.to_integer(), type, body}
  end

  defp receive_all(socket, acc) do
    case :gen_tcp.recv(socket, 0, 30_000) do
      {:ok, bytes} -> receive_all(socket, acc <> bytes)
      {:error, :closed} -> acc
    end
  end
end
