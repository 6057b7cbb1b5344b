defmodule Situ.Live.PeersTest do
  # Counts the sockets of this VM.
  use ExUnit.Case, async: false
  alias Situ.Live.Peers

  test "what one address holds beyond its share is told, the others' is not" do
    {:ok, listener} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(listener)

    accepted =
      for address <- [{127, 0, 0, 2}, {127, 0, 0, 2}, {127, 0, 0, 2}, {127, 0, 0, 3}] do
        {:ok, _} = :gen_tcp.connect({127, 0, 0, 1}, port, ip: address)
        {:ok, socket} = :gen_tcp.accept(listener)
        owner = spawn(fn -> Process.sleep(:infinity) end)
        :ok = :gen_tcp.controlling_process(socket, owner)
        owner
      end

    [_, _, third, _] = accepted
    # The connecting ends are sockets of this test's own process; their port is another.
    assert Peers.excess(port, 2) == [third]
    assert Peers.excess(port, 4) == []
  end
end
