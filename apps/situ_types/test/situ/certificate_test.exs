defmodule Situ.CertificateTest do
  use ExUnit.Case, async: true
  alias Situ.Certificate
  doctest Situ.Certificate

  @tag :tmp_dir
  test "a server speaks TLS with a certificate that names its hosts; the key is its owner's", %{
    tmp_dir: tmp
  } do
    folder = Path.join(tmp, "tls")
    {:ok, tls} = Certificate.ensure(folder, ["lab1", "127.0.0.1", "::1"])
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

    # The client trusts this authority alone, and checks the name it asked for.
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
    assert Certificate.fingerprint(tls[:certfile]) == {:ok, Certificate.fingerprint_of(der)}

    other = client ++ [server_name_indication: ~c"other", log_level: :none]
    assert {:error, _} = :ssl.connect({127, 0, 0, 1}, port, other)
    send(server, :end)
  end

  test "a file without a certificate has no fingerprint" do
    assert {:error, %{code: :bad_certificate}} = Certificate.fingerprint(__ENV__.file)
  end

  @tag :tmp_dir
  test "one that cannot be read is made again", %{tmp_dir: tmp} do
    {:ok, tls} = Certificate.ensure(tmp, ["lab1"])
    unread = :public_key.pem_encode([{:Certificate, "no certificate", :not_encrypted}])

    for text <- [unread, "-----BEGIN CERTIFICATE-----\n!\n-----END CERTIFICATE-----\n", ""] do
      File.write!(tls[:certfile], text)
      assert {:ok, ^tls} = Certificate.ensure(tmp, ["lab1"])
      assert {:ok, _} = Certificate.fingerprint(tls[:certfile])
      made = File.read!(tls[:certfile])
      assert {:ok, ^tls} = Certificate.ensure(tmp, ["lab1"])
      assert File.read!(tls[:certfile]) == made
    end
  end

  @tag :tmp_dir
  test "it is used again while it lasts and names the hosts, made again otherwise", %{
    tmp_dir: tmp
  } do
    {:ok, tls} = Certificate.ensure(tmp, ["lab1"])
    first = File.read!(tls[:certfile])
    assert {:ok, ^tls} = Certificate.ensure(tmp, ["lab1"])
    assert File.read!(tls[:certfile]) == first

    {:ok, _} = Certificate.ensure(tmp, ["lab1", "lab2"])
    refute File.read!(tls[:certfile]) == first

    File.write!(tls[:certfile], "not a certificate")
    assert {:ok, ^tls} = Certificate.ensure(tmp, ["lab1"])
    assert File.read!(tls[:certfile]) =~ "BEGIN CERTIFICATE"
  end

  @tag :tmp_dir
  test "a folder that cannot be made is an error that says so", %{tmp_dir: tmp} do
    File.write!(Path.join(tmp, "file"), "")

    assert {:error, %Situ.Error{code: :cannot_write}} =
             Certificate.ensure(Path.join(tmp, "file/tls"), ["x"])
  end
end
