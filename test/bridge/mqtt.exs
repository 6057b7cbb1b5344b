# Situ's side of the MQTT test: `mqtt.exs publish PORT` sends 2,000 messages, `mqtt.exs subscribe
# PORT READY` receives 500, and 500 more after the broker was killed.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.Mqtt

# `mqtt.exs tls PORT CA` sends in both directions over TLS. `mqtt.exs distrust PORT CA` must not
# connect.
secure = fn ca -> [tls: [authorities: ca, name: "localhost"]] end

hears = fn port, opts, ms ->
  me = self()
  opts = [port: String.to_integer(port)] ++ opts

  {:ok, p} =
    Situ.Pipeline.start_link(fn p ->
      p |> Mqtt.subscribe("127.0.0.1", "lab/tls", opts) |> Situ.each(&send(me, {:got, &1}))
    end)

  {:ok, out} =
    Situ.Pipeline.start(fn p ->
      p
      |> Situ.from_enumerable(for(n <- 1..900, do: {n * 20_000_000, n}))
      |> Mqtt.publish("127.0.0.1", "lab/tls", [retain: true] ++ opts)
    end)

  heard = receive do: ({:got, n} when is_integer(n) -> true), after: (ms -> false)
  {:ok, _} = Situ.Pipeline.stop(p)
  # The sender ends on its own, either with everything delivered or with the number of undelivered
  # messages.
  {heard, with({:ok, _} <- Situ.Pipeline.await(out), do: :ok)}
end

case System.argv() do
  ["tls", port, ca] ->
    {true, :ok} = hears.(port, secure.(ca), 60_000)

  ["distrust", port, ca] ->
    # An unknown authority, and the right authority with the wrong host name.
    {false, {:error, error}} = hears.(port, secure.(ca <> ".other"), 1_500)
    true = Exception.message(error) =~ "900 messages were not delivered"
    {false, {:error, _}} = hears.(port, [tls: [authorities: ca, name: "elsewhere"]], 1_500)

  ["publish", port] ->
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(for(n <- 1..2_000, do: {n * 1_000, %{"n" => n}}))
        |> Mqtt.publish("127.0.0.1", "situ/levels", port: String.to_integer(port), linger: 60_000)
      end)

  ["subscribe", port, ready] ->
    me = self()

    {:ok, p} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Mqtt.subscribe("127.0.0.1", "lab/+/words",
          port: String.to_integer(port),
          session: "situ-test",
          format: :raw
        )
        |> Situ.each(&send(me, {:got, &1}))
      end)

    hear = fn hear, last ->
      receive do
        # Unacknowledged messages arrive again.
        {:got, ^last} -> :ok
        {:got, _} -> hear.(hear, last)
      after
        60_000 -> raise "#{last} did not come"
      end
    end

    hear.(hear, "ready")
    File.write!(ready, "")
    hear.(hear, "word 499")
    hear.(hear, "word 999")
    {:ok, _} = Situ.Pipeline.stop(p)
end
