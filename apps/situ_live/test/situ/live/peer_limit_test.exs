defmodule Situ.Live.PeerLimitTest do
  # Counts the sockets of this VM.
  use ExUnit.Case, async: false
  alias Situ.Live.PeerLimit

  test "finds the newest connections beyond an address's share, and no others" do
    {:ok, listener} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(listener)
    first = connect(listener, port, {127, 0, 0, 2})
    second = connect(listener, port, {127, 0, 0, 2})
    assert {[], earlier} = PeerLimit.find_excess(port, MapSet.new(), 2)
    assert earlier == MapSet.new([first, second])

    third = connect(listener, port, {127, 0, 0, 2})
    other = connect(listener, port, {127, 0, 0, 3})
    # The connecting ends are sockets of this test's own process and have another port.
    assert {[^third], earlier} = PeerLimit.find_excess(port, earlier, 2)
    assert earlier == MapSet.new([first, second, other])
    assert {[], _all} = PeerLimit.find_excess(port, earlier, 4)
  end

  defp connect(listener, port, address) do
    {:ok, _} = :gen_tcp.connect({127, 0, 0, 1}, port, ip: address)
    {:ok, socket} = :gen_tcp.accept(listener)
    owner = spawn(fn -> Process.sleep(:infinity) end)
    :ok = :gen_tcp.controlling_process(socket, owner)
    owner
  end
end
