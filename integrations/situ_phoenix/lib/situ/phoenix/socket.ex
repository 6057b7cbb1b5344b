defmodule Situ.Phoenix.Socket do
  @moduledoc false
  # Maps WebSock's callbacks, in the process of one WebSocket, to `Situ.Live.SocketConnection`.
  @behaviour WebSock
  alias Situ.Live.SocketConnection

  @impl true
  def init(socket), do: socket |> SocketConnection.open() |> to_websock_result()

  @impl true
  def handle_in({data, opcode: opcode}, socket),
    do: socket |> SocketConnection.handle_frame(opcode, data) |> to_websock_result()

  @impl true
  def handle_info(message, socket),
    do: socket |> SocketConnection.handle_info(message) |> to_websock_result()

  @impl true
  def terminate(reason, socket), do: SocketConnection.terminate(socket, reason)

  defp to_websock_result({:send, [], socket}), do: {:ok, socket}
  defp to_websock_result({:send, frames, socket}), do: {:push, frames, socket}
  defp to_websock_result({:close, close, socket}), do: {:stop, :normal, close, socket}
end
