defmodule Situ.Bridge.TcpTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  alias Situ.Bridge.Net.Server
  alias Situ.Bridge.Tcp
  alias Situ.Bridge.Tcp.Frames
  doctest Frames

  @moduletag :capture_log

  defp open(port, most), do: Server.open("127.0.0.1", port, most, {Frames, nil})
  defp listening, do: receive(do: ({:listening, port} -> port))

  test "sends all messages with their times to every client" do
    me = self()
    values = for i <- 1..500, do: {i * 1_000, %{"n" => i}}

    for format <- [:json, :message_pack] do
      {:ok, server} =
        Situ.Pipeline.start_link(fn p ->
          p
          |> Situ.from_enumerable(values)
          |> Tcp.serve(0, wait_for: 2, listening: me, format: format, high_water_mark: 10_000)
        end)

      port = listening()

      clients =
        for id <- 1..2 do
          {:ok, client} =
            Situ.Pipeline.start_link(fn p ->
              p
              |> Tcp.connect("127.0.0.1", port, format: format)
              |> Situ.each(&send(me, {id, &1["n"]}))
            end)

          client
        end

      for id <- 1..2, i <- 1..500, do: assert_receive({^id, ^i})
      Enum.each([server | clients], &Situ.Pipeline.stop/1)
    end
  end

  test "reconnects a client to a restarted server" do
    me = self()
    {:ok, first} = open(0, 10)
    port = Server.port(first)

    {:ok, client} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Tcp.connect("127.0.0.1", port, format: :raw, most: 10)
        |> Situ.each(&send(me, {:got, &1}))
      end)

    assert eventually(fn -> Server.count_ready(first) == 1 end)
    Server.put(first, "before")
    assert_receive {:got, "before"}
    Server.close(first, 100)
    {:ok, second} = open(port, 10)
    assert eventually(fn -> Server.count_ready(second) == 1 end)
    # The frame exceeds the client's limit, so the client disconnects and reconnects.
    Server.put(second, "longer than ten bytes")
    assert eventually(fn -> Server.count_ready(second) == 0 end)
    assert eventually(fn -> Server.count_ready(second) == 1 end)
    Server.put(second, "after")
    assert_receive {:got, "after"}
    Situ.Pipeline.stop(client)
    Server.close(second, 100)
  end

  test "drops messages for a client that does not read, without blocking" do
    {:ok, server} = open(0, 5)

    {:ok, tcp} =
      :gen_tcp.connect('127.0.0.1', Server.port(server), [:binary, active: false, recbuf: 1_024])

    assert eventually(fn -> Server.count_ready(server) == 1 end)
    payload = :binary.copy("x", 1_000_000)
    for _ <- 1..100, do: Server.put(server, payload)
    assert Server.count_dropped(server) > 0
    :gen_tcp.close(tcp)
    assert eventually(fn -> Server.count_ready(server) == 0 end)
    Server.close(server, 100)
  end

  test "returns an error for a port in use" do
    {:ok, server} = open(0, 5)
    assert {:error, %{code: :address_in_use}} = open(Server.port(server), 5)
    assert {:error, %{code: :bad_address}} = Server.open("no such interface", 0, 5, {Frames, nil})
    Server.close(server, 100)
  end
end
