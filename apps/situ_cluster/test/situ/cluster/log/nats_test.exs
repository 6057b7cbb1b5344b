defmodule Situ.Cluster.Log.NatsTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry
  alias Situ.Link.Nats.Connection
  alias Situ.Test.NatsServer

  @moduletag :tmp_dir
  # The tests of the log report once that nats-server is missing.
  @server if(NatsServer.path(), do: [], else: [skip: "there is no nats-server"])

  defp server(dir, opts \\ []) do
    server = NatsServer.start(dir, opts)
    on_exit(fn -> NatsServer.kill(server) end)
    server
  end

  defp entry(i, data), do: %Entry{op: "op.#{i}", data: data, head: %{"Last" => "#{i}"}}

  # Retries until the entry is written or rejected, as a publisher does.
  defp patiently(log, subject, last, entry, left \\ 600) do
    case Log.append(log, subject, last, entry) do
      {:error, %{code: :log_away}} when left > 0 ->
        Process.sleep(50)
        patiently(log, subject, last, entry, left - 1)

      answer ->
        answer
    end
  end

  defp everything(log, subject, from, left \\ 600) do
    case Log.read(log, subject, from, 1_000) do
      {:ok, entries} ->
        for e <- entries, do: Entry.head_integer(e, "Last", 0)

      {:error, %{code: :log_away}} when left > 0 ->
        Process.sleep(50)
        everything(log, subject, from, left - 1)
    end
  end

  describe "a server" do
    @describetag @server

    test "that is killed and restarts has lost and duplicated nothing", %{tmp_dir: dir} do
      server = server(dir)
      {:ok, log} = Log.connect(server.url, timeout: 500)
      subject = {:stream, "s"}
      me = self()

      writer =
        Task.async(fn ->
          Enum.reduce(1..300, 0, fn i, last ->
            {:ok, seq} = patiently(log, subject, last, entry(i, :binary.copy("x", 2_000)))
            if i == 100, do: send(me, :half)
            seq
          end)
        end)

      assert_receive :half
      NatsServer.kill(server)
      server = NatsServer.run(server)
      on_exit(fn -> NatsServer.kill(server) end)
      Task.await(writer, 100_000)
      assert everything(log, subject, 1) == Enum.to_list(1..300)
    end

    test "names its error: too large, log full, no JetStream, wrong password", %{tmp_dir: dir} do
      server = server(Path.join(dir, "a"), settings: "max_payload: 100000")
      {:ok, log} = Log.connect(server.url, max_bytes: 300_000, when_full: :refuse)
      big = :binary.copy("x", 99_000)
      assert {:error, %{code: :too_large}} = Log.append(log, {:stream, "s"}, 0, entry(1, big))
      fits = :binary.copy("x", Log.max_data_size(log))
      {:ok, 1} = Log.append(log, {:stream, "s"}, 0, entry(1, fits))
      {:ok, 2} = Log.append(log, {:stream, "s"}, 1, entry(2, fits))
      {:ok, 3} = Log.append(log, {:stream, "s"}, 2, entry(3, fits))
      assert {:error, %{code: :log_full}} = Log.append(log, {:stream, "s"}, 3, entry(4, fits))
      assert {:ok, %Entry{op: "op.3"}} = Log.fetch_last(log, {:stream, "s"})

      plain = server(Path.join(dir, "b"), jetstream: false)
      assert {:error, %{code: :no_jetstream}} = Log.connect(plain.url)

      secret = server(Path.join(dir, "c"), settings: ~s(authorization { token: "s3cret" }))
      assert {:error, %{code: :refused_login}} = Log.connect(secret.url)
      "nats://" <> host = secret.url
      assert {:ok, _log} = Log.connect("nats://s3cret@" <> host)
    end

    test "rejects the layout of an older version by name", %{tmp_dir: dir} do
      server = server(dir)
      {:ok, log} = Log.connect(server.url)
      older = Situ.JSON.encode(%{"name" => "SITU", "subjects" => ["situ.s.>"]})
      assert %{"config" => _} = asked(log, "$JS.API.STREAM.CREATE.SITU", older)
      assert {:error, %{code: :old_layout, fix: fix}} = Log.connect(server.url)
      assert fix =~ "SITU"
    end

    test "continues counting in a stream whose entries have all expired", %{tmp_dir: dir} do
      server = server(dir)
      {:ok, log} = Log.connect(server.url)
      subject = {:stream, "s"}

      {:ok, 3} =
        Enum.reduce(1..3, {:ok, 0}, fn i, {:ok, seq} ->
          Log.append(log, subject, seq, entry(i, "x"))
        end)

      # Has the same effect as max_age.
      assert %{"success" => true} = asked(log, "$JS.API.STREAM.PURGE.SITU_S_s", "")
      assert {:ok, nil} = Log.fetch_last(log, subject)
      assert {:refused, nil} = Log.append(log, subject, 2, entry(4, "x"))
      assert {:ok, 4} = Log.append(log, subject, 3, entry(4, "x"))
      assert %{"success" => true} = asked(log, "$JS.API.STREAM.PURGE.SITU_S_s", "")
      assert {:ok, 5} = Log.append(log, subject, 0, entry(5, "x"))
      assert {:refused, %Entry{seq: 5}} = Log.append(log, subject, 0, entry(6, "x"))
    end

    test "reports that no handles are left for another stream", %{tmp_dir: dir} do
      server = server(dir, settings: "")
      {:ok, log} = Log.connect(server.url)
      {_, 0} = System.cmd("prlimit", ["--pid", "#{server.pid}", "--nofile=40:40"])

      answers = for i <- 1..30, do: Log.append(log, {:stream, "s#{i}"}, 0, entry(1, "x"))

      assert {:ok, 1} = hd(answers)
      assert {:error, %{code: :log_full, fix: fix}} = List.last(answers)
      assert fix =~ "open files"
    end

    # A site with its own server that connects to the hub. One site keeps no log, the other keeps its own.
    test "a site writes to a log at a hub over a leaf link", %{tmp_dir: dir} do
      leaf = Situ.Test.FreePort.find_tcp()
      listen = ~s(leafnodes { listen: "127.0.0.1:#{leaf}" })
      hub = domain(Path.join(dir, "hub"), "hub", listen)
      remote = ~s(leafnodes { remotes: [ { url: "nats://127.0.0.1:#{leaf}" } ] })
      plain = server(Path.join(dir, "plain"), jetstream: false, settings: remote)
      edge = domain(Path.join(dir, "edge"), "edge", remote)
      {:ok, at_hub} = Log.connect(hub.url)

      for {site, name} <- [{plain, "plain"}, {edge, "edge"}] do
        log = linked(site.url, 600)
        subject = {:stream, name}
        for i <- 1..20, do: assert({:ok, ^i} = patiently(log, subject, i - 1, entry(i, "x")))
        assert {:refused, %Entry{seq: 20}} = Log.append(log, subject, 3, entry(0, "late"))
        assert everything(log, subject, 1) == Enum.to_list(1..20)
        assert everything(at_hub, subject, 1) == Enum.to_list(1..20)
      end

      NatsServer.kill(hub)
      log = %{at_hub | conn: elem(Log.connect(edge.url), 1).conn}
      assert {:ok, []} = Log.list_subjects(log)
      assert {:error, %{code: :bad_option}} = Log.connect(edge.url, domain: "a.b")
    end

    test "three servers: nothing is lost when the leader is killed", %{tmp_dir: dir} do
      ports = for _ <- 1..3, do: {Situ.Test.FreePort.find_tcp(), Situ.Test.FreePort.find_tcp()}
      routes = Enum.map_join(ports, ", ", fn {_, route} -> ~s("nats://127.0.0.1:#{route}") end)

      servers =
        for {{port, route}, i} <- Enum.with_index(ports, 1) do
          settings = ~s(cluster { name: "c", listen: "127.0.0.1:#{route}", routes: [#{routes}] })
          server(Path.join(dir, "n#{i}"), name: "n#{i}", port: port, settings: settings)
        end

      address = "nats://" <> Enum.map_join(ports, ",", fn {port, _} -> "127.0.0.1:#{port}" end)
      log = connected(address, 600)
      subject = {:stream, "s"}
      me = self()

      writer =
        Task.async(fn ->
          Enum.reduce(1..200, 0, fn i, last ->
            {:ok, seq} = patiently(log, subject, last, entry(i, "data"))
            if i == 70, do: send(me, :half)
            seq
          end)
        end)

      assert_receive :half

      # A writer that does not know the last entry is rejected by a cluster too, and does no harm.
      assert {:refused, %Entry{}} = patiently(log, subject, 3, entry(0, "late"))
      assert %{"cluster" => %{"leader" => "n" <> n}} = asked(log, "$JS.API.STREAM.INFO.SITU_S_s")
      servers |> Enum.at(String.to_integer(n) - 1) |> NatsServer.kill()
      Task.await(writer, 100_000)
      assert everything(log, subject, 1) == Enum.to_list(1..200)
    end
  end

  defp domain(dir, name, settings) do
    js = ~s(jetstream { store_dir: "#{Path.join(dir, "js")}", domain: "#{name}" })
    server(dir, jetstream: false, settings: js <> "\n" <> settings)
  end

  # The leaf link needs a moment to connect.
  defp linked(address, left) do
    case Log.connect(address, domain: "hub", timeout: 2_000) do
      {:ok, log} ->
        log

      {:error, %{code: :log_away}} when left > 0 ->
        Process.sleep(50)
        linked(address, left - 1)
    end
  end

  # Only a server's first line counts, so a fake server is enough; Debian has no package of version 2.8.
  test "rejects a server of an old version by name" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(listener)

    for {version, code} <- [{"2.8.4", :old_server}, {"", :old_server}, {"2.9.0", :no_jetstream}] do
      greeter =
        Task.async(fn ->
          {:ok, socket} = :gen_tcp.accept(listener)
          :ok = :gen_tcp.send(socket, ~s(INFO {"version":"#{version}","headers":true}\r\n))
          :gen_tcp.recv(socket, 0, 30_000)
        end)

      assert {:error, %{code: ^code} = error} = Log.connect("nats://127.0.0.1:#{port}")

      if code == :old_server,
        do: assert(error.what =~ "has version #{version}" and error.fix =~ "2.9")

      Task.await(greeter, 30_000)
    end
  end

  defp asked(log, subject, body \\ "") do
    {:ok, %{data: json}} = Connection.request(log.conn.connection, subject, [], body, 5_000)

    {:ok, answer} = Situ.JSON.decode(json)
    answer
  end

  # A cluster needs a while to elect a leader.
  defp connected(address, left) do
    case Log.connect(address, replicas: 3, timeout: 2_000) do
      {:ok, log} ->
        log

      {:error, _} when left > 0 ->
        Process.sleep(100)
        connected(address, left - 1)
    end
  end
end
