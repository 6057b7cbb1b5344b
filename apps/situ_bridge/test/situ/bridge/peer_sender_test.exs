defmodule Situ.Bridge.PeerSenderTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  alias Situ.{Bridge, Pipeline}

  # Returns a port on which nothing listens. A UDP socket holds the number, so that no other test
  # takes it.
  setup do
    {:ok, socket} = :gen_udp.open(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    %{port: port}
  end

  defp numbers(p, n), do: Situ.from_enumerable(p, for(i <- 1..n, do: {i, %{"n" => i}}))

  test "reports how many messages no broker accepted", %{port: port} do
    quiet(fn ->
      assert {:error, error} =
               Pipeline.run(fn p ->
                 p |> numbers(7) |> Bridge.Mqtt.publish("127.0.0.1", "a", port: port, linger: 20)
               end)

      assert %{code: :not_delivered, what: "7 messages were not delivered"} = cause(error)
    end)
  end

  test "stops a stream that is waiting for a broker", %{port: port} do
    quiet(fn ->
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          posted = Situ.event_source(p, fn post -> send(me, {:post, post}) && fn -> :ok end end)
          given = [port: port, linger: 20, high_water_mark: 2]
          Bridge.Mqtt.publish(posted, "127.0.0.1", "a", given)
        end)

      assert_receive {:post, post}, 5_000
      for n <- 1..10, do: post.(%{"n" => n})
      # This is long before `stop_timeout:`, which is 30 s.
      assert {:error, error} = Pipeline.stop(p, timeout: 20_000)
      assert %{code: :not_delivered, what: "10 messages were not delivered"} = cause(error)
    end)
  end

  test "stops a stream that is waiting for its first client" do
    quiet(fn ->
      {:ok, p} =
        Pipeline.start(fn p ->
          p |> numbers(1_000) |> Bridge.Tcp.serve(0, wait_for: 1, linger: 20)
        end)

      assert {:error, error} = Pipeline.stop(p, timeout: 20_000)
      assert %{code: :not_delivered} = cause(error)
    end)
  end

  test "stops a stream whose ZeroMQ peer never connects" do
    quiet(fn ->
      {:ok, p} =
        Pipeline.start(fn p ->
          p |> numbers(5) |> Bridge.ZeroMQ.push("tcp://127.0.0.1:0", linger: 20)
        end)

      assert {:error, error} = Pipeline.stop(p, timeout: 20_000)
      assert %{code: :not_delivered, what: "5 messages" <> _} = cause(error)
    end)
  end

  defp cause(%{meta: %{errors: [error | _]}}), do: error
  defp cause(error), do: error

  defp quiet(fun), do: capture_log(fun)
end
