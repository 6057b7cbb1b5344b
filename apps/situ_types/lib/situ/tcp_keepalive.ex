defmodule Situ.TcpKeepalive do
  @moduledoc false
  # Options of a TCP socket with which the system notices that the other machine is gone, although it never closed the
  # connection: it lost power, or its network was cut. Without them, a client that only receives waits for ever.

  # TCP_KEEPIDLE, TCP_KEEPINTVL and TCP_KEEPCNT: the connection is given up after 25 s of silence.
  @linux [
    {:raw, 6, 4, <<10::native-32>>},
    {:raw, 6, 5, <<5::native-32>>},
    {:raw, 6, 6, <<3::native-32>>}
  ]

  @doc "Returns the options. Other systems than Linux use their own times, usually two hours."
  @spec options() :: [:gen_tcp.option()]
  def options do
    if :os.type() == {:unix, :linux}, do: [{:keepalive, true} | @linux], else: [keepalive: true]
  end
end
