defmodule Situ.Bridge.Foxglove.ClientTest do
  # Tests slow clients.
  use ExUnit.Case, async: true
  alias Situ.Bridge.Foxglove.Client
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  # Starts a client process that is past the handshake, and returns the socket of the other side.
  defp connect(root, args) do
    {:ok, writer} = Writer.create("talk", root)
    :ok = Writer.close(writer)
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(listener)
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
    {:ok, tcp} = :gen_tcp.accept(listener)

    store = Situ.Store.open!(writer.path)
    args = Map.merge(%{store: store, name: "talk", origins: []}, args)
    client = start_supervised!({Client, args})
    monitor = Process.monitor(client)
    :ok = :gen_tcp.controlling_process(tcp, client)
    send(client, {:adopt, tcp})

    :ok =
      :gen_tcp.send(socket, [
        "GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n",
        "Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n"
      ])

    {:ok, "HTTP/1.1 101" <> _} = :gen_tcp.recv(socket, 0, 5_000)
    {socket, monitor}
  end

  # The beginning of a text message of 1,000 bytes.
  @begun <<1::1, 0::3, 1::4, 1::1, 126::7, 1_000::16, 0::32>>

  test "closes the connection if a message is never completed", %{tmp_dir: root} do
    {socket, monitor} = connect(root, %{message_ms: 20})
    :ok = :gen_tcp.send(socket, @begun)
    assert_receive {:DOWN, ^monitor, _, _, {:shutdown, :too_slow}}, 5_000
  end

  test "is not delayed by trickling bytes, and ignores complete messages", %{
    tmp_dir: root
  } do
    {socket, monitor} = connect(root, %{message_ms: 300})
    whole = "{}"
    :ok = :gen_tcp.send(socket, [<<1::1, 0::3, 1::4, 1::1, 2::7, 0::32>>, whole, @begun])
    trickle(socket)
    assert_receive {:DOWN, ^monitor, _, _, {:shutdown, :too_slow}}, 5_000
  end

  # Sends bytes until the other side closes.
  defp trickle(socket) do
    with :ok <- :gen_tcp.send(socket, "x"),
         {:error, :timeout} <- drain(socket),
         do: trickle(socket)
  end

  defp drain(socket) do
    with {:ok, _} <- :gen_tcp.recv(socket, 0, 10), do: drain(socket)
  end
end
