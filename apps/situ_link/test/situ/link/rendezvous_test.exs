defmodule Situ.Link.RendezvousTest do
  use ExUnit.Case, async: true
  import Situ.Test.LinkRecordings, only: [eventually: 1]
  alias Situ.Link.Rendezvous
  alias Situ.Link.Rendezvous.Protocol
  doctest Rendezvous

  defp join(port, name, opts \\ []) do
    {:ok, member} =
      Rendezvous.join("127.0.0.1", [port: port, name: name, listener: self()] ++ opts)

    member
  end

  test "processes join, change and leave, and a late one learns of the others" do
    {:ok, server} = Rendezvous.serve(port: 0)
    port = Rendezvous.port(server)
    desk = join(port, "desk")
    offer = {:address, "situ://r1/robot", [{"imu", ":float"}]}
    robot = join(port, "robot", endpoints: [offer])
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^offer]}}}
    more = [offer, {:clock, "r1", 11_511, []}]
    :ok = Rendezvous.announce(robot, more)
    assert_receive {:situ_rendezvous, ^desk, {:removed, "robot"}}
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: ^more}}}
    late = join(port, "late")
    eventually(fn -> Enum.map(Rendezvous.peers(late), & &1.name) == ["desk", "robot"] end)
    known = %{name: "robot", address: "situ://r1/robot", streams: [{"imu", ":float"}]}
    assert known in Situ.Link.peers([late])
    Process.unlink(robot)
    Process.exit(robot, :kill)
    assert_receive {:situ_rendezvous, ^late, {:removed, "robot"}}
    eventually(fn -> Enum.map(Rendezvous.peers(desk), & &1.name) == ["late"] end)
  end

  test "reconnects to a server that was away" do
    {:ok, server} = Rendezvous.serve(port: 0)
    port = Rendezvous.port(server)
    {a, b} = {join(port, "a"), join(port, "b")}
    assert_receive {:situ_rendezvous, ^a, {:added, %{name: "b"}}}
    GenServer.stop(server)
    assert_receive {:situ_rendezvous, ^a, {:removed, "b"}}
    eventually(fn -> Rendezvous.error(a) != nil end)
    {:ok, _} = Rendezvous.serve(port: port)
    assert_receive {:situ_rendezvous, ^a, {:added, %{name: "b"}}}
    assert_receive {:situ_rendezvous, ^b, {:added, %{name: "a"}}}
  end

  @tag capture_log: true
  test "a process with a taken name is notified, and visible when the name is free" do
    {:ok, server} = Rendezvous.serve(port: 0)
    port = Rendezvous.port(server)
    desk = join(port, "desk")
    [one, two] = for n <- ["one", "two"], do: {:address, "situ://r1/#{n}", []}
    first = join(port, "robot", endpoints: [one])
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^one]}}}
    second = join(port, "robot", endpoints: [two])
    assert_receive {:situ_rendezvous, ^second, {:taken, "robot"}}
    assert Rendezvous.error(second) =~ ~s(another process is already named "robot")
    assert Rendezvous.error(first) == nil
    GenServer.stop(first)
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^two]}}}
    eventually(fn -> Rendezvous.error(second) == nil end)
    # Its offers may still change, and it receives no notice about itself.
    :ok = Rendezvous.announce(second, [one, two])
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^one, ^two]}}}
    assert Enum.map(Rendezvous.peers(second), & &1.name) == ["desk"]
    refute_received {:situ_rendezvous, ^second, {:added, %{name: "robot"}}}
  end

  test "an incompatible client, a silent client and noise do no harm" do
    {:ok, server} = Rendezvous.serve(port: 0)
    port = Rendezvous.port(server)
    connect = fn -> elem(:gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false]), 1) end
    silent = connect.()
    other = connect.()
    :ok = :gen_tcp.send(other, <<9::little-16>>)
    assert {:ok, <<2::little-16>>} = :gen_tcp.recv(other, 2, 30_000)
    assert {:error, :closed} = :gen_tcp.recv(other, 1, 30_000)

    for seed <- 1..200 do
      noise = connect.()
      :rand.seed(:exsss, {seed, 0, 0})

      _ =
        :gen_tcp.send(noise, [<<Protocol.protocol_version()::little-16>>, <<1>>, :rand.bytes(64)])

      :gen_tcp.close(noise)
    end

    a = join(port, "a")
    _b = join(port, "b")
    assert_receive {:situ_rendezvous, ^a, {:added, %{name: "b"}}}
    :gen_tcp.close(silent)
  end

  defp raw(port) do
    {:ok, socket} =
      :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, nodelay: true])

    socket
  end

  defp greet(socket) do
    :ok = :gen_tcp.send(socket, <<Protocol.protocol_version()::little-16>>)
    :gen_tcp.recv(socket, 2, 30_000)
  end

  # An announcement of about 900 kB without its end.
  defp long do
    streams = for i <- 1..10_000, do: {"stream #{i}", ":float"}
    endpoints = for i <- 1..5, do: {:tcp, "host", i, streams}
    add = {:add, %{name: "long", version: "1", endpoints: endpoints}}
    bytes = IO.iodata_to_binary(Protocol.encode(add))
    binary_part(bytes, 0, byte_size(bytes) - 3_000)
  end

  test "disconnects clients that are silent or do not finish an announcement" do
    {:ok, server} = Rendezvous.serve(port: 0, deadline: 200)
    port = Rendezvous.port(server)
    member = join(port, "member")
    {silent, half, begun} = {raw(port), raw(port), raw(port)}
    :ok = :gen_tcp.send(half, <<2>>)
    {:ok, _} = greet(begun)
    :ok = :gen_tcp.send(begun, <<1, 200>>)
    assert {:error, :closed} = :gen_tcp.recv(silent, 0, 30_000)
    assert {:error, :closed} = :gen_tcp.recv(half, 0, 30_000)
    assert {:error, _closed} = until_closed(begun)
    # A member with nothing unfinished may be silent for any time.
    assert Rendezvous.error(member) == nil
    _ = join(port, "late")
    assert_receive {:situ_rendezvous, ^member, {:added, %{name: "late"}}}
    refute_received {:situ_rendezvous, ^member, {:removed, _}}
  end

  defp until_closed(socket) do
    with {:ok, _bytes} <- :gen_tcp.recv(socket, 0, 30_000), do: until_closed(socket)
  end

  test "a thousand silent clients shut nobody out, before or after the greeting" do
    {:ok, server} = Rendezvous.serve(port: 0)
    port = Rendezvous.port(server)
    first = join(port, "first")

    silent =
      for i <- 1..1_010,
          socket = raw(port),
          do:
            (
              if(rem(i, 2) == 0, do: greet(socket))
              socket
            )

    _ = join(port, "second")
    assert_receive {:situ_rendezvous, ^first, {:added, %{name: "second"}}}, 30_000
    for socket <- silent, do: :gen_tcp.close(socket)
  end

  test "the cost of bytes that trickle in after a long announcement is linear" do
    {:ok, server} = Rendezvous.serve(port: 0, deadline: 600_000)
    slow = raw(Rendezvous.port(server))
    {:ok, _} = greet(slow)
    first = reductions(server)
    long = long()
    :ok = :gen_tcp.send(slow, long)
    eventually(fn -> :sys.get_state(server).pending == byte_size(long) end)
    whole = reductions(server)

    for _ <- 1..200, do: {:gen_tcp.send(slow, "x"), reductions(server)}
    eventually(fn -> :sys.get_state(server).pending == byte_size(long) + 200 end)

    # All of them together cost about as much as the announcement, not each of them.
    assert reductions(server) - whole < whole - first
  end

  # The call makes the server process its mailbox first.
  defp reductions(server) do
    [] = GenServer.call(server, :processes)
    {:reductions, n} = Process.info(server, :reductions)
    n
  end
end
