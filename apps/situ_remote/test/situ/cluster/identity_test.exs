defmodule Situ.Cluster.IdentityTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.Identity

  @moduletag :tmp_dir

  test "nobody else reads it, and it is not made twice", %{tmp_dir: dir} do
    folder = Path.join(dir, "identity")
    assert :ok = Identity.create(folder)

    for name <- File.ls!(folder) do
      assert Bitwise.band(File.stat!(Path.join(folder, name)).mode, 0o777) == 0o600
    end

    assert Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700
    {:ok, cookie} = Identity.cookie(folder)
    assert byte_size(Atom.to_string(cookie)) >= 40
    assert {:error, %{code: :exists}} = Identity.create(folder)
    assert {:ok, ^cookie} = Identity.cookie(folder)
    assert {:error, %{code: :no_cookie}} = Identity.cookie(dir)
  end

  test "its certificates make a TLS connection with each other, and with nobody else", %{
    tmp_dir: dir
  } do
    {:ok, _} = Application.ensure_all_started(:ssl)
    [ours, theirs] = for name <- ["ours", "theirs"], do: Path.join(dir, name)
    for folder <- [ours, theirs], do: :ok = Identity.create(folder)
    assert :ok = handshake(ours, ours)
    assert {:error, _} = handshake(ours, theirs)
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

  # As rel/overlays/bin/cluster-flags has them.
  defp options(folder) do
    file = &Path.join(folder, &1)
    files = [certfile: file.("node.pem"), keyfile: file.("node.key"), cacertfile: file.("ca.pem")]
    [verify: :verify_peer] ++ files
  end
end
