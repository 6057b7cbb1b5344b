defmodule Situ.Link.ServerTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  import Situ.Test.LinkRecordings
  alias Situ.{Delivery, Error, Link}
  alias Situ.Link.Wire.{Frame, Handshake}
  alias Situ.Link.Server

  setup do
    root = folder()
    recording = begin(root, "lobby", %{"n" => messages(1..500)})
    {:ok, root: root, recording: recording, path: Path.join(root, "lobby")}
  end

  defp raw(server) do
    {:ok, socket} =
      :gen_tcp.connect({127, 0, 0, 1}, Server.port(server), [:binary, packet: 4, active: false])

    socket
  end

  # A logged-in session for messages that a proper client would never send.
  defp logged_in(server, token \\ "", name \\ "lobby") do
    socket = raw(server)
    nonce = Handshake.new_nonce()
    :ok = :gen_tcp.send(socket, Frame.encode(Handshake.build_hello(nonce)))
    {:ok, {:hello, _, _, theirs}} = next(socket)
    proof = Handshake.build_proof(token, :client, theirs, nonce)
    :ok = :gen_tcp.send(socket, Frame.encode({:login, proof, %{"name" => name}}))
    {:ok, {:welcome, _, _}} = next(socket)
    {:ok, {:streams, _}} = next(socket)
    socket
  end

  defp next(socket) do
    with {:ok, body} <- :gen_tcp.recv(socket, 0, 30_000), do: Frame.decode(body)
  end

  defp refusal(socket) do
    case next(socket) do
      {:ok, {:refused, map}} -> Handshake.error_from_map(map)
      {:ok, _} -> refusal(socket)
      error -> error
    end
  end

  defp open(address, opts),
    do: Situ.to_list(fn p -> p |> Link.open(address, opts) |> Link.stream("n") end)

  test "a wrong token is an error on both sides, and guesses are limited", %{path: path} do
    server = serve(path, token: "right")

    log =
      capture_log(fn ->
        error = assert_raise Error, fn -> open(address(server), token: "wrong") end
        assert {error.code, error.fix} == {:wrong_token, "give both sides the same `token:`"}

        for _ <- 1..25,
            do: assert_raise(Error, fn -> open(address(server), token: "wrong", wait: 200) end)
      end)

    assert log =~ "the token of the link is wrong"
    eventually(fn -> Server.info(server).refused > 20 end)
    # After 20 wrong tokens within a minute the address has to wait, whatever it sends.
    assert {:error, _} = next(raw(server))
  end

  test "a client beyond the limit receives the reason", %{path: path} do
    server = serve(path)

    capture_log(fn ->
      # The limit for one address.
      taken = for _ <- 1..250, do: raw(server)
      for socket <- taken, do: {:ok, {:hello, _, _, _}} = next(socket)
      socket = raw(server)
      {:ok, {:hello, _, _, theirs}} = next(socket)
      nonce = Handshake.new_nonce()
      :ok = :gen_tcp.send(socket, Frame.encode(Handshake.build_hello(nonce)))
      proof = Handshake.build_proof("", :client, theirs, nonce)
      :ok = :gen_tcp.send(socket, Frame.encode({:login, proof, %{"name" => "lobby"}}))
      assert %{code: :too_many_clients, fix: fix} = refusal(socket)
      assert fix =~ "close unused links"
      for socket <- taken, do: :gen_tcp.close(socket)
    end)
  end

  test "a client with another token than the server's reports it", %{path: path} do
    server = serve(path)

    capture_log(fn ->
      assert %{code: :wrong_token} =
               assert_raise(Error, fn -> open(address(server), token: "x") end)
    end)
  end

  test "rejects another version with the versions of both sides", %{path: path} do
    server = serve(path)
    socket = raw(server)

    capture_log(fn ->
      :ok = :gen_tcp.send(socket, Frame.encode({:hello, 9, 7, Handshake.new_nonce()}))
      error = refusal(socket)
      assert error.code == :wrong_version
      assert error.why == "this side supports 1 to 1, the other side 7 to 9"
    end)
  end

  test "reports a name that is not served and a peer that is not a server", %{path: path} do
    server = serve(path)

    capture_log(fn ->
      assert %{code: :no_recording} =
               assert_raise(Error, fn -> open(address(server, "hall"), []) end)
    end)

    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(listener)

    spawn_link(fn ->
      {:ok, socket} = :gen_tcp.accept(listener)
      :gen_tcp.send(socket, "HTTP/1.1 400 Bad Request\r\n\r\n")
      Process.sleep(:infinity)
    end)

    error = assert_raise Error, fn -> open("situ://127.0.0.1:#{port}/lobby", []) end
    assert error.code == :no_link
  end

  test "another interface requires a token", %{path: path} do
    assert {:error, %{code: :open_to_all}} = Link.serve(path, port: 0, interface: "0.0.0.0")
    server = serve(path, interface: "0.0.0.0", token: :none)
    assert Server.port(server) > 0
    assert {:error, %{code: :no_store}} = Link.serve(path <> "-not", port: 0)

    assert {:error, %{code: :address_in_use}} =
             Link.serve(path, port: Server.port(server), interface: "0.0.0.0", token: "t")
  end

  test "20,000 invalid frames do no harm", %{path: path, recording: recording} do
    server = serve(path)
    :rand.seed(:exsss, {1, 2, 3})
    atoms = :erlang.system_info(:atom_count)

    capture_log(fn ->
      sent = for round <- 1..400, reduce: 0, do: (n -> n + rubbish(server, round))
      assert sent >= 20_000
    end)

    eventually(fn -> Server.info(server).clients == [] end)
    # Other tests on this machine also create some atoms.
    assert :erlang.system_info(:atom_count) - atoms < 5_000
    finish(recording)
    assert received(address(server), "n") == Enum.to_list(1..500)
  end

  # Some before the login and some after it: broken copies of valid frames, and noise.
  defp rubbish(server, round) do
    socket = if rem(round, 4) == 0, do: raw(server), else: logged_in(server)
    right = IO.iodata_to_binary(Frame.encode(Enum.random(good())))
    frames = for _ <- 1..50, do: broken(right, :rand.uniform(4))
    # With its own framing all fifty are sent, whatever the server does with the first.
    :ok = :inet.setopts(socket, packet: :raw)
    _ = :gen_tcp.send(socket, for(frame <- frames, do: <<byte_size(frame)::32, frame::binary>>))
    :gen_tcp.close(socket)
    50
  end

  defp good do
    [
      {:subscribe, :rand.uniform(3), %{"name" => "n", "from" => "start", "window" => 1_000}},
      {:subscribe, 7,
       %{"name" => "n", "from" => %{"after" => 17}, "window" => 1, "policy" => "latest"}},
      {:subscribe, 8, %{"name" => "n", "from" => "now", "window" => -5}},
      {:subscribe, 9, %{"name" => ["n"], "from" => 1, "window" => 1.0e300}},
      {:credit, :rand.uniform(9), 0xFFFFFFFF},
      {:unsubscribe, 1},
      {:ping, 0x7FFFFFFFFFFFFFFF},
      {:batch, 1, 1, 2, 3, "x"},
      {:hello, 1, 1, Handshake.new_nonce()},
      {:request, 1, %{"what" => "everything"}}
    ]
  end

  defp broken(right, 1), do: right
  defp broken(right, 2), do: binary_part(right, 0, :rand.uniform(byte_size(right)) - 1)
  defp broken(_right, 3), do: :rand.bytes(:rand.uniform(200))

  defp broken(right, 4) do
    at = :rand.uniform(byte_size(right)) - 1
    <<before::binary-size(at), _, rest::binary>> = right
    <<before::binary, :rand.uniform(256) - 1, rest::binary>>
  end

  test "a frame that claims four gigabytes ends the connection", %{path: path} do
    server = serve(path)
    socket = logged_in(server)
    :ok = :inet.setopts(socket, packet: :raw)

    capture_log(fn ->
      :ok = :gen_tcp.send(socket, <<0xFFFFFFF0::32, "x">>)
      :ok = closed(socket)
    end)
  end

  defp closed(socket) do
    case :gen_tcp.recv(socket, 0, 30_000) do
      {:ok, _} -> closed(socket)
      {:error, reason} when reason in [:closed, :econnreset] -> :ok
    end
  end

  test "a client that does not read slows nobody", %{path: path, root: root, recording: recording} do
    finish(recording)
    big = begin(root, "big", %{"b" => messages(1..200, fn t -> :binary.copy(<<t>>, 100_000) end)})
    finish(big)
    server = serve(%{"lobby" => path, "big" => Path.join(root, "big")})

    deaf =
      for _ <- 1..20 do
        socket = raw(server)
        nonce = Handshake.new_nonce()
        :ok = :gen_tcp.send(socket, Frame.encode(Handshake.build_hello(nonce)))
        {:ok, {:hello, _, _, theirs}} = next(socket)
        proof = Handshake.build_proof("", :client, theirs, nonce)
        :ok = :gen_tcp.send(socket, Frame.encode({:login, proof, %{"name" => "big"}}))
        ask = %{"name" => "b", "from" => "start", "window" => 100_000_000}
        :ok = :gen_tcp.send(socket, Frame.encode({:subscribe, 1, ask}))
        socket
      end

    assert received(address(server), "n") == Enum.to_list(1..500)
    assert length(received(address(server, "big"), "b")) == 200
    for socket <- deaf, do: :gen_tcp.close(socket)
  end

  test "sends no more than a client has room for", %{path: path} do
    server = serve(path)
    socket = logged_in(server)
    ask = %{"name" => "n", "from" => "start", "window" => 100}
    :ok = :gen_tcp.send(socket, Frame.encode({:subscribe, 1, ask}))
    assert {:ok, {:subscribed, 1, _}} = next(socket)
    # Room for a hundred bytes lets one frame through, whatever its size.
    assert {:ok, {:batch, 1, 1, 500, 500, _}} = next(socket)
    assert {:error, :timeout} = :gen_tcp.recv(socket, 0, 100)
  end

  test "counts messages that a slow link drops, and delivers the newest", %{root: root} do
    open = begin(root, "cam", %{"c" => messages(1..50, fn t -> :binary.copy(<<t>>, 50_000) end)})
    server = serve(Path.join(root, "cam"))
    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        link = Link.open(p, address(server, "cam"), from: :start)
        send(me, {:link, link})

        link
        |> Link.stream("c", policy: Delivery.latest())
        |> Situ.each(&send(me, {:got, :binary.first(&1)}))
      end)

    assert_receive {:link, link}
    assert_receive {:got, 50}
    refute_received {:got, _}
    finish(open)
    assert {:ok, _} = Situ.Pipeline.await(pipeline)
    assert %{} = link
  end

  test "sends higher priority first over a slow link", %{root: root} do
    finish(
      begin(root, "two", %{
        "bulk" => messages(1..60, fn t -> :binary.copy(<<t>>, 20_000) end),
        "vital" => messages(1..60)
      })
    )

    server = serve(Path.join(root, "two"), quota: {:bytes_per_second, 500_000})
    socket = logged_in(server, "", "two")
    ask = &Frame.encode({:subscribe, &1, Map.merge(%{"from" => "start", "window" => &2}, &3)})
    :ok = :gen_tcp.send(socket, ask.(1, 1, %{"name" => "bulk"}))
    assert {:ok, {:subscribed, 1, _}} = next(socket)

    # Make room for everything, then request the other stream. The quota lets little through before that.
    :ok = :gen_tcp.send(socket, Frame.encode({:credit, 1, 10_000_000}))
    :ok = :gen_tcp.send(socket, ask.(2, 10_000_000, %{"name" => "vital", "priority" => 5}))
    assert before_vital(socket, 0) <= 12
  end

  # Chunks of 25 kB (50 ms of the quota) that arrive before the first batch of the second stream.
  defp before_vital(socket, n) do
    case next(socket) do
      {:ok, {:part, 1, _, _}} -> before_vital(socket, n + 1)
      {:ok, {:batch, 2, 1, 60, 60, _}} -> n
      {:ok, {:subscribed, 2, _}} -> before_vital(socket, n)
    end
  end

  test "announces and starts streams that begin later", %{
    path: path,
    recording: {writer, streams}
  } do
    server = serve(path)
    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        link = Link.open(p, address(server), from: :start)
        send(me, {:link, link})
        link |> Link.stream("late", type: :integer) |> Situ.each(&send(me, {:late, &1}))
      end)

    assert_receive {:link, link}
    assert Map.keys(Link.streams(link)) == ["n"]
    {:ok, late} = Situ.Store.Writer.stream(writer, "late", type: :integer)
    {:ok, late} = Situ.Store.Writer.append(late, messages(5..7))
    for i <- 5..7, do: assert_receive({:late, ^i})
    eventually(fn -> Link.streams(link)["late"] == :integer end)
    finish({writer, Map.put(streams, "late", late)})
    assert {:ok, _} = Situ.Pipeline.await(pipeline)
  end

  test "requires TLS with a certificate when the server uses it", %{
    path: path,
    root: root,
    recording: recording
  } do
    finish(recording)
    %{server_config: served, client_config: known} = certificates()
    server = serve(path, tls: served)
    address = "situs://localhost:#{Server.port(server)}/lobby"
    tls = Keyword.take(known, [:cacerts]) ++ [verify: :verify_peer]
    assert length(received(address, "n", from: :start, tls: tls)) == 500

    assert_raise Error, ~r/TLS|does not speak|no stream/, fn ->
      received("situ://127.0.0.1:#{Server.port(server)}/lobby", "n", from: :start, wait: 2_000)
    end

    assert File.dir?(root)

    # Certificates signed by another authority or for another host are rejected immediately, with the reason.
    %{client_config: stranger} = certificates()
    other = Keyword.take(stranger, [:cacerts])
    numbered = String.replace(address, "localhost", "127.0.0.1")

    for {address, tls, words} <- [
          {address, other, "not trusted"},
          {numbered, tls, "different host"}
        ] do
      error = assert_raise Error, fn -> received(address, "n", from: :start, tls: tls) end
      assert error.code == :wrong_certificate
      assert error.what =~ words
    end
  end

  test "accepts TLS to an address in the certificate", %{path: path, recording: recording} do
    finish(recording)
    address = {:Extension, {2, 5, 29, 17}, :asn1_DEFAULT, [iPAddress: <<127, 0, 0, 1>>]}
    %{server_config: served, client_config: known} = certificates(address)
    server = serve(path, tls: served)
    tls = Keyword.take(known, [:cacerts])
    at = "situs://127.0.0.1:#{Server.port(server)}/lobby"
    assert length(received(at, "n", from: :start, tls: tls)) == 500
    other = String.replace(at, "127.0.0.1", "localhost")
    error = assert_raise Error, fn -> received(other, "n", from: :start, tls: tls) end
    assert error.code == :wrong_certificate
  end

  @localhost {:Extension, {2, 5, 29, 17}, :asn1_DEFAULT, [dNSName: 'localhost']}

  defp certificates(name \\ @localhost) do
    key = [key: {:namedCurve, :secp256r1}, digest: :sha256]
    chain = %{root: key, intermediates: [], peer: key ++ [extensions: [name]]}

    :public_key.pkix_test_data(%{
      server_chain: chain,
      client_chain: %{root: key, intermediates: [], peer: key}
    })
  end

  test "a Unix socket is open to this user only", %{path: path, root: root, recording: recording} do
    finish(recording)
    socket = Path.join(root, "lab.sock")
    serve(path, port: :none, unix: socket)
    assert File.stat!(socket).mode |> Bitwise.band(0o777) == 0o600
    assert length(received("situ+unix://#{socket}?lobby", "n")) == 500
  end

  test "images larger than a frame arrive in chunks, also at a slow reader", %{root: root} do
    data = for i <- 1..6, do: :binary.copy(<<i>>, 9_000_000)
    finish(begin(root, "wide", %{"w" => messages(1..6, &Enum.at(data, &1 - 1))}))
    server = serve(Path.join(root, "wide"))
    assert received(address(server, "wide"), "w") == data
  end
end
