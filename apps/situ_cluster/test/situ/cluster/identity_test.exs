defmodule Situ.Cluster.IdentityTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.Identity
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry
  alias Situ.Link.Nats.Servers
  alias Situ.Test.NatsServer

  @moduletag :tmp_dir

  test "is readable by nobody else and is created once", %{tmp_dir: dir} do
    folder = Path.join(dir, "identity")
    assert :ok = Identity.create(folder)

    {folders, files} = Path.wildcard(folder <> "/**") |> Enum.split_with(&File.dir?/1)
    assert length(files) >= 12
    for file <- files, do: assert(Bitwise.band(File.stat!(file).mode, 0o777) == 0o600)

    for folder <- [folder | folders],
        do: assert(Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700)

    {:ok, cookie} = Identity.read_cookie(folder)
    assert byte_size(Atom.to_string(cookie)) >= 40
    assert {:error, %{code: :exists}} = Identity.create(folder)
    assert {:ok, ^cookie} = Identity.read_cookie(folder)
    assert {:error, %{code: :no_cookie}} = Identity.read_cookie(dir)
  end

  test "its certificates connect over TLS with each other only", %{
    tmp_dir: dir
  } do
    {:ok, _} = Application.ensure_all_started(:ssl)
    [ours, theirs] = for name <- ["ours", "theirs"], do: Path.join(dir, name)
    for folder <- [ours, theirs], do: :ok = Identity.create(folder)
    assert :ok = handshake(ours, ours)
    assert {:error, _} = handshake(ours, theirs)
  end

  if NatsServer.path() do
    test "its NATS server admits only its own nodes, by TLS and password", %{
      tmp_dir: dir
    } do
      [ours, theirs] = for name <- ["ours", "theirs"], do: Path.join(dir, name)
      for folder <- [ours, theirs], do: :ok = Identity.create(folder)
      server = Path.join(ours, "nats-server")
      config = Path.join(server, "nats-server.conf")
      port = Situ.Test.FreePort.find_tcp()
      text = File.read!(config) |> String.replace("0.0.0.0:4222", "127.0.0.1:#{port}")
      File.write!(config, text)
      running = NatsServer.run(%{dir: server, port: port, config: "nats-server.conf"})
      on_exit(fn -> NatsServer.kill(running) end)
      address = "nats://127.0.0.1:#{port}"
      options = Identity.log_options(ours)

      assert {:ok, log} = Log.connect(address, options)
      assert {:ok, _seq} = Log.append(log, {:stream, "s"}, 0, %Entry{op: "x", data: "y"})
      refute inspect(:sys.get_state(log.conn.connection), limit: :infinity) =~ password(ours)

      # Either half alone is not enough, and neither are another cluster's credentials.
      assert {:error, _} = Log.connect(address)
      assert {:error, %{code: :refused_login}} = Log.connect(address, tls: options[:tls])
      assert {:error, _} = Log.connect(address, credentials: options[:credentials])
      assert {:error, _} = Log.connect(address, Identity.log_options(theirs))
      theirs_tls = Keyword.put(options, :tls, Identity.log_options(theirs)[:tls])
      assert {:error, _} = Log.connect(address, theirs_tls)
      other_password = Keyword.put(options, :credentials, Path.join(theirs, "nats-credentials"))
      assert {:error, %{code: :refused_login}} = Log.connect(address, other_password)
    end

    test "a server without TLS is not mistaken for one with TLS", %{tmp_dir: dir} do
      identity = Path.join(dir, "identity")
      :ok = Identity.create(identity)
      plain = NatsServer.start(Path.join(dir, "plain"))
      on_exit(fn -> NatsServer.kill(plain) end)

      assert {:error, %{code: :no_tls, fix: fix}} =
               Log.connect(plain.url, Identity.log_options(identity))

      assert fix =~ "nats-server.conf"
    end
  end

  test "credentials come from a file or from the address, but not from both", %{tmp_dir: dir} do
    file = Path.join(dir, "credentials")
    File.write!(file, "ann:a:b c\nmore\n")
    assert Servers.resolve_login(%{}, file) == {:ok, %{"user" => "ann", "pass" => "a:b c"}}
    File.write!(file, "t0ken")
    assert Servers.resolve_login(%{}, file) == {:ok, %{"auth_token" => "t0ken"}}
    assert {:error, %{code: :bad_option}} = Servers.resolve_login(%{"user" => "x"}, file)
    File.write!(file, "\n")
    assert {:error, %{code: :no_credentials}} = Servers.resolve_login(%{}, file)
    assert {:error, %{code: :no_credentials}} = Servers.resolve_login(%{}, file <> "x")
    assert {:ok, _, %{"user" => "u", "pass" => "p w"}} = Servers.parse("nats://u:p%20w@h:1")
  end

  defp password(folder) do
    [_, password] =
      folder
      |> Path.join("nats-credentials")
      |> File.read!()
      |> String.split([":", "\n"], trim: true)

    password
  end

  defp handshake(server, client) do
    s = [fail_if_no_peer_cert: true] ++ options(server)
    c = [verify_fun: {&Identity.verify/3, []}] ++ options(client)
    {:ok, listen} = :ssl.listen(0, [ip: {127, 0, 0, 1}, log_level: :none] ++ s)
    {:ok, {_, port}} = :ssl.sockname(listen)

    accept =
      Task.async(fn ->
        {:ok, socket} = :ssl.transport_accept(listen)
        with {:ok, _} <- :ssl.handshake(socket, 20_000), do: :ok
      end)

    connected = :ssl.connect({127, 0, 0, 1}, port, [log_level: :none] ++ c, 20_000)
    answer = Task.await(accept, 30_000)
    with {:ok, _} <- connected, do: answer
  end

  # As in rel/overlays/bin/cluster-flags.
  defp options(folder) do
    file = &Path.join(folder, &1)
    files = [certfile: file.("node.pem"), keyfile: file.("node.key"), cacertfile: file.("ca.pem")]
    [verify: :verify_peer] ++ files
  end
end
