defmodule Situ.Link.Rendezvous.NatsMemberTest do
  # The name server is configured in the application's environment, so this is not async.
  use ExUnit.Case, async: false
  import Situ.Test.LinkRecordings, only: [eventually: 1]
  alias Situ.Link.{Address, Rendezvous}
  alias Situ.Link.Nats.Connection
  alias Situ.Test.NatsServer

  @moduletag :tmp_dir
  # The tests of the log report once that nats-server is missing.
  unless NatsServer.path(), do: @moduletag(skip: "there is no nats-server")

  defp server(dir, opts \\ []) do
    server = NatsServer.start(dir, [jetstream: false] ++ opts)
    on_exit(fn -> NatsServer.kill(server) end)
    server
  end

  defp join(server, name, opts \\ []) do
    opts = [name: name, listener: self(), beat: 100] ++ opts
    {:ok, member} = Rendezvous.join(server.url, opts)
    member
  end

  defp names(member), do: Enum.map(Rendezvous.peers(member), & &1.name)
  defp offer(name), do: {:address, "situ://10.0.0.7:4000/#{name}", [{"imu", ":float"}]}

  test "processes join, change and leave, and a late one learns of the others", %{
    tmp_dir: dir
  } do
    server = server(dir)
    desk = join(server, "desk")
    robot = join(server, "robot", endpoints: [offer("robot")])
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot"} = process}}, 5_000
    assert process.endpoints == [offer("robot")]
    more = [offer("robot"), {:clock, "r1", 11_511, []}]
    :ok = Rendezvous.announce(robot, more)
    assert_receive {:situ_rendezvous, ^desk, {:removed, "robot"}}, 5_000
    assert_receive {:situ_rendezvous, ^desk, {:added, %{endpoints: ^more}}}, 5_000
    late = join(server, "late")
    eventually(fn -> names(late) == ["desk", "robot"] end)
    known = %{name: "robot", address: "situ://10.0.0.7:4000/robot", streams: [{"imu", ":float"}]}
    assert known in Situ.Link.peers([late])

    GenServer.stop(robot)
    assert_receive {:situ_rendezvous, ^late, {:removed, "robot"}}, 5_000
    # A killed process sends no farewell.
    Process.unlink(desk)
    Process.exit(desk, :kill)
    assert_receive {:situ_rendezvous, ^late, {:removed, "desk"}}, 5_000
  end

  test "a server that is killed and restarts finds all processes again", %{tmp_dir: dir} do
    server = server(dir)
    {a, b} = {join(server, "a"), join(server, "b")}
    eventually(fn -> {names(a), names(b)} == {["b"], ["a"]} end)
    NatsServer.kill(server)
    assert_receive {:situ_rendezvous, ^a, {:removed, "b"}}, 10_000
    server = NatsServer.run(server)
    on_exit(fn -> NatsServer.kill(server) end)
    assert_receive {:situ_rendezvous, ^a, {:added, %{name: "b"}}}, 10_000
    eventually(fn -> names(b) == ["a"] end)
  end

  test "waits for a missing server and reports it", %{tmp_dir: dir} do
    port = Situ.Test.FreePort.find_tcp()
    member = join(%{url: "nats://127.0.0.1:#{port}"}, "a")
    eventually(fn -> Rendezvous.error(member) end)
    assert Rendezvous.error(member) =~ "cannot connect to a NATS server"
    server(dir, port: port)
    eventually(fn -> Rendezvous.error(member) == nil end)
    assert {:error, %{code: :bad_address}} = Rendezvous.join("nats://", name: "a")
  end

  @tag capture_log: true
  test "with a duplicate name the first counts, both are notified, and noise is ignored", %{
    tmp_dir: dir
  } do
    server = server(dir)
    desk = join(server, "desk")
    one = join(server, "robot", endpoints: [offer("one")])
    eventually(fn -> names(desk) == ["robot"] end)
    other = join(server, "robot", endpoints: [offer("two")])
    assert_receive {:situ_rendezvous, ^one, {:taken, "robot"}}, 5_000
    assert_receive {:situ_rendezvous, ^other, {:taken, "robot"}}, 5_000
    assert Rendezvous.error(other) =~ ~s(another process is already named "robot")

    {:ok, noisy} = Connection.start_link(servers: [{"127.0.0.1", server.port}], jetstream: false)

    for seed <- 1..200 do
      :rand.seed(:exsss, {seed, 0, 0})
      Connection.publish(noisy, "situ.peers", "_INBOX.noise", [1 | :rand.bytes(64)])
    end

    last = join(server, "last")
    eventually(fn -> "last" in names(desk) and "robot" in names(last) end)
    assert [%{endpoints: [endpoint]}] = for(p <- Rendezvous.peers(desk), p.name == "robot", do: p)
    assert endpoint == offer("one")
    GenServer.stop(one)
    two = offer("two")
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: [^two]}}}, 5_000
    eventually(fn -> Rendezvous.error(other) == nil end)
  end

  # An edge site with its own server that connects to the hub: a leaf link.
  test "names reach across a leaf link and resolve to addresses", %{tmp_dir: dir} do
    leaf = Situ.Test.FreePort.find_tcp()
    hub = server(Path.join(dir, "hub"), settings: ~s(leafnodes { listen: "127.0.0.1:#{leaf}" }))
    remotes = ~s(leafnodes { remotes: [ { url: "nats://127.0.0.1:#{leaf}" } ] })
    edge = server(Path.join(dir, "edge"), settings: remotes)
    desk = join(hub, "desk")
    robot = join(edge, "robot 7", endpoints: [offer("robot")])
    assert_receive {:situ_rendezvous, ^desk, {:added, %{name: "robot 7"}}}, 10_000
    assert_receive {:situ_rendezvous, ^robot, {:added, %{name: "desk"}}}, 10_000

    put_nats(hub.url)
    link = %Address{transport: :tcp, host: "robot 7"}
    assert {:ok, %{host: "10.0.0.7", port: 4_000, name: "robot"}} = Address.resolve(link)
    assert {:ok, %{name: "other"}} = Address.resolve(%{link | name: "other"})
    assert {:ok, %{host: "desk", port: 11_411}} = Address.resolve(%{link | host: "desk"})
    GenServer.stop(robot)
    assert {:ok, %{host: "robot 7", port: 11_411}} = Address.resolve(link)
    NatsServer.kill(hub)
    assert {:ok, %{host: "robot 7", port: 11_411}} = Address.resolve(link)
  end

  defp put_nats(url) do
    Application.put_env(:situ_link, :nats, url)
    on_exit(fn -> Application.delete_env(:situ_link, :nats) end)
  end
end
