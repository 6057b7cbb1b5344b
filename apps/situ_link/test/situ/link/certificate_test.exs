defmodule Situ.Link.CertificateTest do
  use ExUnit.Case, async: true
  alias Situ.Link.Certificate
  doctest Situ.Link.Certificate

  @tag :tmp_dir
  test "serves TLS with a certificate for its hosts and an owner-only key", %{tmp_dir: tmp} do
    folder = Path.join(tmp, "tls")
    {:ok, tls} = Certificate.ensure_files(folder, ["lab1", "127.0.0.1", "::1"])
    assert Bitwise.band(File.stat!(tls[:keyfile]).mode, 0o777) == 0o600
    assert Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700

    {:ok, listener} = :ssl.listen(0, tls ++ [active: false, ip: {127, 0, 0, 1}])
    {:ok, {_, port}} = :ssl.sockname(listener)

    server =
      spawn_link(fn ->
        for _ <- 1..2 do
          {:ok, socket} = :ssl.transport_accept(listener)
          with {:ok, socket} <- :ssl.handshake(socket), do: :ssl.send(socket, "hello")
        end

        receive(do: (:end -> :ok))
      end)

    # The client trusts only this authority, and checks the requested name.
    client = [
      verify: :verify_peer,
      cacertfile: Path.join(folder, "authority.pem"),
      active: false,
      mode: :binary
    ]

    named = client ++ [server_name_indication: ~c"lab1"]
    {:ok, socket} = :ssl.connect({127, 0, 0, 1}, port, named)
    assert {:ok, "hello"} = :ssl.recv(socket, 5, 10_000)
    {:ok, der} = :ssl.peercert(socket)
    assert Certificate.fetch_fingerprint(tls[:certfile]) == {:ok, Certificate.fingerprint_of(der)}

    other = client ++ [server_name_indication: ~c"other", log_level: :none]
    assert {:error, _} = :ssl.connect({127, 0, 0, 1}, port, other)
    send(server, :end)
  end

  test "a file without a certificate has no fingerprint" do
    assert {:error, %{code: :bad_certificate}} = Certificate.fetch_fingerprint(__ENV__.file)
  end

  @tag :tmp_dir
  test "replaces an unreadable certificate", %{tmp_dir: tmp} do
    {:ok, tls} = Certificate.ensure_files(tmp, ["lab1"])
    unread = :public_key.pem_encode([{:Certificate, "no certificate", :not_encrypted}])

    for text <- [unread, "-----BEGIN CERTIFICATE-----\n!\n-----END CERTIFICATE-----\n", ""] do
      File.write!(tls[:certfile], text)
      assert {:ok, ^tls} = Certificate.ensure_files(tmp, ["lab1"])
      assert {:ok, _} = Certificate.fetch_fingerprint(tls[:certfile])
      made = File.read!(tls[:certfile])
      assert {:ok, ^tls} = Certificate.ensure_files(tmp, ["lab1"])
      assert File.read!(tls[:certfile]) == made
    end
  end

  @tag :tmp_dir
  test "reuses a certificate while it is valid and names the hosts, and otherwise replaces it", %{
    tmp_dir: tmp
  } do
    {:ok, tls} = Certificate.ensure_files(tmp, ["lab1"])
    first = File.read!(tls[:certfile])
    assert {:ok, ^tls} = Certificate.ensure_files(tmp, ["lab1"])
    assert File.read!(tls[:certfile]) == first

    {:ok, _} = Certificate.ensure_files(tmp, ["lab1", "lab2"])
    refute File.read!(tls[:certfile]) == first

    File.write!(tls[:certfile], "not a certificate")
    assert {:ok, ^tls} = Certificate.ensure_files(tmp, ["lab1"])
    assert File.read!(tls[:certfile]) =~ "BEGIN CERTIFICATE"
  end

  @tag :tmp_dir
  test "returns an error if the folder cannot be created", %{tmp_dir: tmp} do
    File.write!(Path.join(tmp, "file"), "")

    assert {:error, %Situ.Error{code: :cannot_write}} =
             Certificate.ensure_files(Path.join(tmp, "file/tls"), ["x"])
  end
end
