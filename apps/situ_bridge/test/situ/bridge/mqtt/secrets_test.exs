defmodule Situ.Bridge.Mqtt.SecretsTest do
  # Logs, dumps and observers show the graph and the states of processes, so the test inspects
  # every process that was started since it began.
  use ExUnit.Case, async: false
  alias Situ.Bridge.Mqtt

  @password "the-password-of-this-test"
  @login [username: "sensor", password: @password]

  test "sends the password to the broker, and shows it in no process state" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(listener)
    earlier = Process.list()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Mqtt.subscribe("127.0.0.1", "in", [port: port] ++ @login)
        |> Mqtt.publish("127.0.0.1", "out", [port: port] ++ @login)
      end)

    for _publisher_and_subscriber <- 1..2, do: assert(accept(listener) =~ @password)

    states = states(Process.list() -- earlier)
    assert length(states) >= 3
    for state <- states, do: refute(state =~ @password)
    refute inspect(Situ.Pipeline.info(pipeline), limit: :infinity) =~ @password
    Situ.Pipeline.stop(pipeline)
  end

  defp accept(listener) do
    {:ok, socket} = :gen_tcp.accept(listener, 10_000)
    {:ok, bytes} = :gen_tcp.recv(socket, 0, 10_000)
    bytes
  end

  defp states(pids) do
    for pid <- pids,
        {:dictionary, dictionary} <- [Process.info(pid, :dictionary)],
        {module, _, _} <- [dictionary[:"$initial_call"]],
        String.starts_with?(inspect(module), "Situ."),
        do: inspect(:sys.get_state(pid), limit: :infinity, printable_limit: :infinity)
  end
end
