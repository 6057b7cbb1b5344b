defmodule Situ.Bench.BridgeCodecs do
  @moduledoc false
  # Encodes messages for another system and decodes them, and runs that system's own library in
  # the same run. `-python` uses its Python package (`SITU_BENCH_PYTHON`, otherwise the one that
  # test/bridge installs; skipped without it), and MQTT uses mosquitto's clients. MQTT needs a
  # broker, NATS, whose own time is not counted.
  alias Situ.{Bridge, Pipeline}
  alias Situ.Bridge.Format

  @root Path.expand("../..", __DIR__)

  def tests do
    [
      {"bridge-message-pack", &message_pack/1},
      {"bridge-message-pack-python", &python("message_pack", 50_000, &1)},
      {"bridge-protobuf", &protobuf/1},
      {"bridge-protobuf-python", &python("protobuf", 50_000, &1)},
      {"bridge-mcap-python", &python("mcap", 100_000, &1)},
      {"bridge-parquet-python", &python("parquet", 200_000, &1)},
      {"bridge-mqtt", &mqtt/1},
      {"bridge-mqtt-mosquitto", &mosquitto/1}
    ]
  end

  defp message_pack(scale) do
    n = max(1, round(50_000 * scale))

    Situ.Bench.measure("bridge_message_pack", n, fn ->
      for i <- 1..n do
        {:ok, bytes} = Format.encode(:message_pack, %{"n" => i, "x" => i / 3}, i * 100)
        {:ok, {_, %{"n" => ^i}}} = Format.decode(:message_pack, bytes)
      end

      []
    end)
  end

  defp protobuf(scale) do
    n = max(1, round(50_000 * scale))
    schema = Bridge.Foxglove.Messages.load_schema()

    Situ.Bench.measure("bridge_protobuf", n, fn ->
      for i <- 1..n do
        message = %{
          "timestamp" => i * 1_000_007,
          "level" => "INFO",
          "message" => "a message",
          "name" => "bench",
          "line" => i
        }

        {:ok, bytes} = Bridge.Protobuf.encode(schema, "foxglove.Log", message)
        {:ok, %{"line" => ^i}} = Bridge.Protobuf.decode(schema, "foxglove.Log", bytes)
      end

      []
    end)
  end

  defp python(what, n, scale) do
    name = "bridge_#{what}_python"

    case Situ.Bench.python("bridge.py", [what, "#{max(1, round(n * scale))}"]) do
      {:ok, [rate, cpu]} -> [{name, rate, "msg/s"}, {name <> "_cpu", cpu, "us/msg"}]
      :error -> []
    end
  end

  defp mqtt(scale) do
    n = max(1, round(20_000 * scale))

    broker(fn port ->
      me = self()
      values = Stream.map(1..n, &{&1 * 1_000, %{"n" => &1, "x" => &1 / 3}})

      {:ok, receiver} =
        Pipeline.start_link(fn p ->
          p
          |> Bridge.Mqtt.subscribe("127.0.0.1", "bench/#", port: port, qos: 0)
          |> Situ.each(&send(me, {:got, &1["n"]}))
        end)

      # The broker does not report when a subscription is active, so one message is sent
      # repeatedly until it arrives.
      hello(port)

      measured =
        Situ.Bench.measure("bridge_mqtt", n, fn ->
          {:ok, _} =
            Pipeline.run(fn p ->
              p
              |> Situ.from_enumerable(values)
              |> Bridge.Mqtt.publish("127.0.0.1", "bench/a", port: port, linger: 60_000)
            end)

          await(n)
          []
        end)

      Pipeline.stop(receiver)
      measured
    end)
  end

  defp hello(port) do
    {:ok, _} =
      Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable([{1, %{"n" => 0}}])
        |> Bridge.Mqtt.publish("127.0.0.1", "bench/a", port: port, linger: 5_000)
      end)

    receive do
      {:got, 0} -> :ok
    after
      200 -> hello(port)
    end
  end

  defp await(n) do
    receive do
      {:got, ^n} -> :ok
      {:got, _} -> await(n)
    after
      60_000 -> raise "the last message did not come"
    end
  end

  # The CPU time is that of both clients, as counted by the shell.
  defp mosquitto(scale) do
    n = max(1, round(20_000 * scale))

    if System.find_executable("mosquitto_pub") do
      broker(fn port ->
        script = """
        mosquitto_sub -h 127.0.0.1 -p #{port} -t 'bench/#' -C #{n} >/dev/null &
        sleep 1
        s=$(date +%s%N)
        seq -f '{"originatingTime":"2020-01-01T00:00:00.0000000Z","message":{"n":%.0f,"x":0.5}}' #{n} |
          mosquitto_pub -h 127.0.0.1 -p #{port} -t bench/a -q 1 -l
        wait
        echo $(( $(date +%s%N) - s ))
        times
        """

        {out, 0} = System.cmd("bash", ["-c", script], env: [{"LC_ALL", "C"}])
        [wall, _shell, children] = String.split(out, "\n", trim: true)
        seconds = String.to_integer(wall) / 1.0e9

        used =
          for [_, m, s] <- Regex.scan(~r/(\d+)m([\d.]+)s/, children),
              do: String.to_integer(m) * 60 + String.to_float(s)

        [
          {"bridge_mqtt_mosquitto", n / seconds, "msg/s"},
          {"bridge_mqtt_mosquitto_cpu", Enum.sum(used) / n * 1.0e6, "us/msg"}
        ]
      end)
    else
      IO.puts(
        :stderr,
        "bridge-mqtt-mosquitto: mosquitto's clients are not installed; nothing is measured"
      )

      []
    end
  end

  defp broker(fun) do
    own = Path.join(@root, "apps/situ_link/priv/nats/nats-server")
    server = System.get_env("SITU_NATS_SERVER") || System.find_executable("nats-server") || own

    if File.exists?(server) do
      root = Path.join(System.tmp_dir!(), "situ-bench-mqtt-#{System.pid()}")
      File.rm_rf!(root)
      File.mkdir_p!(root)
      [port, nats] = for _ <- 1..2, do: Situ.Bench.free_port()

      config = """
      listen: 127.0.0.1:#{nats}
      server_name: bench
      jetstream { store_dir: "#{root}" }
      mqtt { listen: "127.0.0.1:#{port}" }
      """

      File.write!(Path.join(root, "nats.conf"), config)
      args = ["-c", Path.join(root, "nats.conf")]
      process = Port.open({:spawn_executable, server}, [:binary, :stderr_to_stdout, args: args])
      {:os_pid, pid} = Port.info(process, :os_pid)

      try do
        ready(port, 100)
        fun.(port)
      after
        System.cmd("kill", ["#{pid}"])
        File.rm_rf!(root)
      end
    else
      IO.puts(:stderr, "bridge-mqtt: there is no nats-server; nothing is measured")
      []
    end
  end

  defp ready(port, tries) when tries > 0 do
    case :gen_tcp.connect('127.0.0.1', port, []) do
      {:ok, tcp} ->
        :gen_tcp.close(tcp)

      {:error, _} ->
        Process.sleep(50)
        ready(port, tries - 1)
    end
  end
end
