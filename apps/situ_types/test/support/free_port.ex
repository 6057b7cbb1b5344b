defmodule Situ.Test.FreePort do
  @moduledoc """
  Finds unused ports of 127.0.0.1 for servers that a test starts.

  A port is free when it is returned, but another program may take it before the test does.

      iex> Situ.Test.FreePort.find_tcp() in 1..65_535 and Situ.Test.FreePort.find_udp() in 1..65_535
      true
  """
  @loopback [ip: {127, 0, 0, 1}]

  @doc "Returns a free TCP port."
  @spec find_tcp() :: :inet.port_number()
  def find_tcp do
    {:ok, socket} = :gen_tcp.listen(0, @loopback)
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    port
  end

  @doc "Returns a free UDP port."
  @spec find_udp() :: :inet.port_number()
  def find_udp do
    {:ok, socket} = :gen_udp.open(0, @loopback)
    {:ok, port} = :inet.port(socket)
    :gen_udp.close(socket)
    port
  end
end
