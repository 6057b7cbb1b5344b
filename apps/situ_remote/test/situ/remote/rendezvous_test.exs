defmodule Situ.Remote.RendezvousTest do
  use ExUnit.Case, async: true
  import Situ.Remote.Test.Recordings, only: [eventually: 1]
  alias Situ.Remote.Rendezvous
  alias Situ.Remote.Rendezvous.Wire
  doctest Rendezvous

  defp join(port, name, opts \\ []) do
    {:ok, member} =
      Rendezvous.join("127.0.0.1", [port: port, name: name, listener: self()] ++ opts)

    member
  end

  test "processes come, change and go; whoever comes late hears of those that are there" do
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
    assert known in Situ.Remote.peers([late])
    Process.unlink(robot)
    Process.exit(robot, :kill)
    assert_receive {:situ_rendezvous, ^late, {:removed, "robot"}}
    eventually(fn -> Enum.map(Rendezvous.peers(desk), & &1.name) == ["late"] end)
  end

  test "a server that was away is found again" do
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
  test "one whose name is another's is told, and seen when that has gone" do
    {:ok, server} = Rendezvous.serve(port: 0)
    port = Rendezvous.port(server)
    desk = join(port, "desk")
    [one, two] = for n <- ["one", "two"], do: {:address, "situ://r1/#{n}", []}
    first = join(port, "robot", endpoints: [one])
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^one]}}}
    second = join(port, "robot", endpoints: [two])
    assert_receive {:situ_rendezvous, ^second, {:taken, "robot"}}
    assert Rendezvous.error(second) =~ ~s(another process is called "robot")
    assert Rendezvous.error(first) == nil
    GenServer.stop(first)
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^two]}}}
    eventually(fn -> Rendezvous.error(second) == nil end)
    # Its offers may change as before; it is told of nothing of its own.
    :ok = Rendezvous.announce(second, [one, two])
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^one, ^two]}}}
    assert Enum.map(Rendezvous.peers(second), & &1.name) == ["desk"]
    refute_received {:situ_rendezvous, ^second, {:added, %{name: "robot"}}}
  end

  test "a client of another version, a silent one and noise harm nobody" do
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
      _ = :gen_tcp.send(noise, [<<Wire.version()::little-16>>, <<1>>, :rand.bytes(64)])
      :gen_tcp.close(noise)
    end

    a = join(port, "a")
    _b = join(port, "b")
    assert_receive {:situ_rendezvous, ^a, {:added, %{name: "b"}}}
    :gen_tcp.close(silent)
  end
end
