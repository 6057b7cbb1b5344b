defmodule Situ.Bridge.ZeroMQTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  alias Situ.Bridge.ZeroMQ
  alias Situ.Bridge.ZeroMQ.{Socket, Wire}
  doctest Socket

  defp address do
    receive do
      {:listening, port} -> "tcp://127.0.0.1:#{port}"
    end
  end

  defp collect(p, me, address, opts) do
    p |> ZeroMQ.subscribe(address, opts) |> Situ.each(&send(me, {:got, &1}))
  end

  test "delivers published values in every format" do
    me = self()

    for format <- [:json, :message_pack, :csv] do
      opts = [topic: "t", format: format]

      {:ok, _} =
        Situ.Pipeline.start_link(fn p ->
          p
          |> Situ.from_enumerable(for(i <- 1..100, do: {i, i * 1.5}))
          |> ZeroMQ.publish("tcp://127.0.0.1:0", [wait_for: 1, listening: me] ++ opts)
        end)

      at = address()

      {:ok, receiver} =
        Situ.Pipeline.start_link(fn p ->
          p
          |> ZeroMQ.subscribe(at, opts)
          |> Situ.map(&{&1, self()})
          |> Situ.each(fn {x, _} -> send(me, {:got, x}) end)
        end)

      for i <- 1..100, do: assert_receive({:got, x} when x == i * 1.5)
      Situ.Pipeline.stop(receiver)
    end
  end

  test "matches the exact topic, or its prefix if requested" do
    me = self()

    {:ok, socket} =
      Socket.open(:pub, "tcp://127.0.0.1:0", bind: true, high_water_mark: 10, most: 1_000)

    at = "tcp://127.0.0.1:#{Socket.port(socket)}"

    {:ok, one} =
      Situ.Pipeline.start_link(fn p -> collect(p, me, at, topic: "a", format: :raw) end)

    {:ok, all} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> ZeroMQ.subscribe(at, topic: "a", format: :raw, prefix: true)
        |> Situ.each(&send(me, {:all, &1}))
      end)

    assert eventually(fn -> Socket.count_ready(socket) == 2 end)
    for topic <- ["a", "ab", "b", "a"], do: Socket.put(socket, [topic, topic])
    for topic <- ["a", "ab", "a"], do: assert_receive({:all, ^topic})
    for _ <- 1..2, do: assert_receive({:got, "a"})
    refute_received {:got, "ab"}
    Enum.each([one, all], &Situ.Pipeline.stop/1)
    Socket.close(socket, 100)
  end

  test "reconnects a subscriber to a restarted publisher" do
    me = self()

    {:ok, first} =
      Socket.open(:pub, "tcp://127.0.0.1:0", bind: true, high_water_mark: 10, most: 1_000)

    port = Socket.port(first)
    at = "tcp://127.0.0.1:#{port}"

    {:ok, receiver} =
      Situ.Pipeline.start_link(fn p -> collect(p, me, at, topic: "", format: :raw) end)

    assert eventually(fn -> Socket.count_ready(first) == 1 end)
    Socket.put(first, ["", "before"])
    assert_receive {:got, "before"}
    Socket.close(first, 100)
    {:ok, second} = Socket.open(:pub, at, bind: true, high_water_mark: 10, most: 1_000)
    assert eventually(fn -> Socket.count_ready(second) == 1 end)
    Socket.put(second, ["", "after"])
    assert_receive {:got, "after"}
    Situ.Pipeline.stop(receiver)
    Socket.close(second, 100)
  end

  test "distributes pushed messages without loss while a puller is slow" do
    me = self()

    {:ok, sender} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Situ.from_enumerable(for(i <- 1..2_000, do: {i, i}))
        |> ZeroMQ.push("tcp://127.0.0.1:0", wait_for: 2, listening: me, high_water_mark: 10)
      end)

    at = address()

    pullers =
      for _ <- 1..2,
          do:
            elem(
              Situ.Pipeline.start_link(fn p ->
                p |> ZeroMQ.pull(at, high_water_mark: 10) |> Situ.each(&send(me, {:got, &1}))
              end),
              1
            )

    got = for _ <- 1..2_000, do: receive(do: ({:got, i} -> i))
    assert Enum.sort(got) == Enum.to_list(1..2_000)
    Enum.each([sender | pullers], &Situ.Pipeline.stop/1)
  end

  test "ignores connections that do not speak the protocol" do
    {:ok, socket} =
      Socket.open(:pub, "tcp://127.0.0.1:0", bind: true, high_water_mark: 10, most: 1_000)

    port = Socket.port(socket)

    ExUnit.CaptureLog.capture_log(fn ->
      for noise <- [
            "GET / HTTP/1.1\r\n\r\n" <> :binary.copy("x", 100),
            :crypto.strong_rand_bytes(200),
            Wire.greeting() <> <<4, 255, 1, 2, 3>>
          ] do
        {:ok, tcp} = :gen_tcp.connect('127.0.0.1', port, [:binary, active: false])
        :gen_tcp.send(tcp, noise)
        :gen_tcp.close(tcp)
      end

      assert eventually(fn -> map_size(:sys.get_state(socket).peers) == 0 end)
    end)

    assert Socket.count_ready(socket) == 0
    Socket.close(socket, 100)
  end

  test "returns an error for an address that cannot be bound" do
    {:ok, socket} =
      Socket.open(:pub, "tcp://127.0.0.1:0", bind: true, high_water_mark: 10, most: 1_000)

    at = "tcp://127.0.0.1:#{Socket.port(socket)}"

    assert {:error, %{code: :address_in_use}} =
             Socket.open(:pub, at, bind: true, high_water_mark: 10, most: 1)

    assert {:error, %{code: :bad_address}} = Socket.open(:pub, "udp://x", bind: true)
    Socket.close(socket, 100)
  end
end
