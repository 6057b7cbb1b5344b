defmodule Situ.Live.CertificateTest do
  use ExUnit.Case, async: true
  alias Situ.Live.Certificate

  @tag :tmp_dir
  test "a server speaks TLS with a certificate that names its hosts; the key is its owner's", %{
    tmp_dir: tmp
  } do
    folder = Path.join(tmp, "tls")
    {:ok, tls} = Certificate.ensure(folder, ["lab1", "127.0.0.1", "::1"])
    assert Bitwise.band(File.stat!(tls[:keyfile]).mode, 0o777) == 0o600
    assert Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700

    {:ok, server} =
      Situ.Live.start_link(
        port: 0,
        tls: tls,
        routes: [{:get, "/", fn _ -> Situ.Live.Response.text("hello") end}]
      )

    assert "https://localhost:" <> _ = Situ.Live.url(server)

    # The client trusts this authority alone, and checks the name it asked for.
    client = [
      verify: :verify_peer,
      cacertfile: Path.join(folder, "authority.pem"),
      active: false,
      mode: :binary
    ]

    {:ok, socket} =
      :ssl.connect(
        {127, 0, 0, 1},
        Situ.Live.port(server),
        client ++ [server_name_indication: ~c"lab1"]
      )

    :ok = :ssl.send(socket, "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    {:ok, answer} = :ssl.recv(socket, 0, 10_000)
    assert answer =~ "200"

    assert {:error, _} =
             :ssl.connect(
               {127, 0, 0, 1},
               Situ.Live.port(server),
               client ++ [server_name_indication: ~c"other", log_level: :none]
             )
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
