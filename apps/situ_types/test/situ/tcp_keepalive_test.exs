defmodule Situ.TcpKeepaliveTest do
  use ExUnit.Case, async: true
  alias Situ.TcpKeepalive

  test "the system accepts the options and uses them" do
    {:ok, listener} = :gen_tcp.listen(0, [ip: {127, 0, 0, 1}] ++ TcpKeepalive.options())
    {:ok, port} = :inet.port(listener)
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, TcpKeepalive.options())
    assert {:ok, [keepalive: true]} = :inet.getopts(socket, [:keepalive])

    if :os.type() == {:unix, :linux},
      do:
        assert(
          {:ok, [{:raw, 6, 4, <<10::native-32>>}]} = :inet.getopts(socket, [{:raw, 6, 4, 4}])
        )
  end
end
