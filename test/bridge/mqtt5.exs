# Situ's side of the test of MQTT 5: `mqtt5.exs PORT` sends through a proxy that cuts every connection after a few
# packets, in each direction, to a broker that is reached directly.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.Mqtt
Logger.configure(level: :error)

defmodule CuttingProxy do
  # Passes whole packets on. Connection n is cut after packet n (1 to `most`) of the client or of the broker, in turns.
  def start(target, most) do
    {:ok, listener} =
      :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false, nodelay: true])

    {:ok, port} = :inet.port(listener)
    cuts = :counters.new(1, [])
    pid = spawn_link(fn -> accept(listener, target, most, cuts) end)
    :gen_tcp.controlling_process(listener, pid)
    {port, fn -> :counters.get(cuts, 1) end}
  end

  defp accept(listener, target, most, cuts) do
    {:ok, client} = :gen_tcp.accept(listener)
    n = :counters.get(cuts, 1)
    :counters.add(cuts, 1, 1)

    {:ok, server} =
      :gen_tcp.connect({127, 0, 0, 1}, target, [:binary, active: false, nodelay: true])

    :inet.setopts(client, active: :once)
    :inet.setopts(server, active: :once)
    {cut, free} = if rem(n, 2) == 0, do: {client, server}, else: {server, client}

    pass({client, server}, %{cut => rem(div(n, 2), most) + 1, free => :infinity}, %{
      client => "",
      server => ""
    })

    :gen_tcp.close(client)
    :gen_tcp.close(server)
    accept(listener, target, most, cuts)
  end

  defp pass({client, server} = pair, left, buffers) do
    receive do
      {:tcp, socket, bytes} when socket in [client, server] ->
        other = if socket == client, do: server, else: client
        {more, rest} = pass_packets(other, buffers[socket] <> bytes, left[socket])
        :inet.setopts(socket, active: :once)
        if more != 0, do: pass(pair, %{left | socket => more}, %{buffers | socket => rest})

      {:tcp_closed, socket} when socket in [client, server] ->
        :ok
    end
  end

  defp pass_packets(_other, rest, 0), do: {0, rest}

  defp pass_packets(other, <<_, after_type::binary>> = bytes, left) do
    with {:ok, size, body} when size <= byte_size(body) <-
           Mqtt.Properties.parse_variable(after_type) do
      length = byte_size(bytes) - byte_size(body) + size
      <<packet::binary-size(length), rest::binary>> = bytes
      :gen_tcp.send(other, packet)
      pass_packets(other, rest, if(left == :infinity, do: left, else: left - 1))
    else
      _ -> {left, bytes}
    end
  end

  defp pass_packets(_other, "", left), do: {left, ""}
end

defmodule Exactly do
  def run(version, qos, publisher_port, subscriber_port, count) do
    me = self()
    topic = "exactly/#{version}/#{System.unique_integer([:positive])}"

    {:ok, p} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Mqtt.subscribe("127.0.0.1", topic,
          port: subscriber_port,
          qos: qos,
          version: version,
          format: :raw
        )
        |> Situ.each(&send(me, {:got, &1}))
      end)

    wait_until_subscribed(topic, publisher_port, version)

    {:ok, out} =
      Situ.Pipeline.start(fn p ->
        p
        |> Situ.from_enumerable(for(n <- 1..count, do: {n * 1_000, "n#{n}"}))
        |> Mqtt.publish("127.0.0.1", topic,
          port: publisher_port,
          qos: qos,
          version: version,
          format: :raw,
          linger: 60_000
        )
      end)

    {:ok, _} = Situ.Pipeline.await(out)
    got = hear("n#{count}", [])
    {:ok, _} = Situ.Pipeline.stop(p)
    got
  end

  defp wait_until_subscribed(_topic, _port, _version), do: Process.sleep(1_500)

  defp hear(last, got) do
    receive do
      {:got, ^last} -> hear_rest(Enum.reverse([last | got]))
      {:got, word} -> hear(last, [word | got])
    after
      60_000 ->
        raise "#{last} did not come after #{length(got)} messages: #{inspect(Enum.take(got, 3))}"
    end
  end

  # What comes twice comes soon.
  defp hear_rest(got) do
    receive do
      {:got, word} -> hear_rest(got ++ [word])
    after
      500 -> got
    end
  end
end

[port] = System.argv()
port = String.to_integer(port)

for version <- [5, 4] do
  {cut_port, cuts} = CuttingProxy.start(port, 40)
  words = for n <- 1..100, do: "n#{n}"
  ^words = Exactly.run(version, 2, cut_port, port, 100)
  sent_cuts = cuts.()
  {cut_port, cuts} = CuttingProxy.start(port, 40)
  ^words = Exactly.run(version, 2, port, cut_port, 100)

  IO.puts(
    "version #{version}: all exactly once; connections: publisher #{sent_cuts}, subscriber #{cuts.()}"
  )

  true = sent_cuts > 5 and cuts.() > 5
end

# Properties of mosquitto_pub arrive, and a request is answered on its response topic, which mosquitto_sub reads.
defmodule Peers do
  def mosquitto(port, program, args),
    do:
      System.cmd("mosquitto_" <> program, ["-V", "5", "-p", "#{port}" | args],
        stderr_to_stdout: true
      )

  def repeat_until(fun, left \\ 100) do
    fun.()

    receive do
      {:request, request} -> request
    after
      100 -> if left > 0, do: repeat_until(fun, left - 1), else: raise("no request came")
    end
  end
end

me = self()

answer =
  Task.async(fn ->
    Peers.mosquitto(port, "sub", ~w(-t answers/a -C 1 -W 30 -F) ++ ["%p %C %D %P"])
  end)

{:ok, p} =
  Situ.Pipeline.start_link(fn p ->
    p
    |> Mqtt.subscribe("127.0.0.1", "ask/+",
      port: port,
      qos: 2,
      share: "workers",
      envelope: true,
      format: :raw
    )
    |> Situ.each(&send(me, {:request, &1}))
    |> Situ.map(fn request ->
      %Mqtt.Message{
        topic: request.response_topic,
        correlation_data: request.correlation_data,
        user_properties: [{"unit", "C"}],
        payload: "21.5"
      }
    end)
    |> Mqtt.publish("127.0.0.1", "answers", port: port, format: :raw, content_type: "text/plain")
  end)

ask =
  ~w(-t ask/temperature -m now -q 2 -D publish content-type text/plain -D publish response-topic answers/a) ++
    ~w(-D publish correlation-data 7 -D publish user-property room lab -D publish message-expiry-interval 60)

request = Peers.repeat_until(fn -> {_, 0} = Peers.mosquitto(port, "pub", ask) end)

%Mqtt.Message{
  topic: "ask/temperature",
  payload: "now",
  qos: 2,
  content_type: "text/plain",
  response_topic: "answers/a",
  correlation_data: "7",
  user_properties: [{"room", "lab"}]
} = request

{"21.5 text/plain 7 unit:C situ-originating-time:" <> _, 0} = Task.await(answer, 40_000)
{:ok, _} = Situ.Pipeline.stop(p)
IO.puts("properties, shared subscription and answer: right")
