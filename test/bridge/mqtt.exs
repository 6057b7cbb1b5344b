# Situ's side of MQTT: `mqtt.exs publish PORT` sends 2,000 messages, `mqtt.exs subscribe PORT READY` hears 500 and 500
# more, which come after the broker was killed.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.Mqtt

# `mqtt.exs tls PORT CA` both ways by TLS; `mqtt.exs distrust PORT CA` must not come through.
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
  # The sender ends by itself: with all of it delivered, or with the number of what was not.
  {heard, with({:ok, _} <- Situ.Pipeline.await(out), do: :ok)}
end

case System.argv() do
  ["tls", port, ca] ->
    {true, :ok} = hears.(port, secure.(ca), 60_000)

  ["distrust", port, ca] ->
    # Another authority, and the right one for another name.
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
        # Messages that are not acknowledged come again.
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
