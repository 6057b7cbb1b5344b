defmodule Situ.Live.Yaws.WebSocket do
  @moduledoc false
  # Maps Yaws's callbacks, in the process of one WebSocket, to `Situ.Live.SocketConnection`.
  alias Situ.Live.SocketConnection

  @compile {:no_warn_undefined, [:yaws_websockets]}

  # The handler starts in handle_open, because nothing may be sent earlier.
  def init([_arg, socket]), do: {:ok, socket}

  def handle_open(connection, socket) do
    case SocketConnection.open(socket) do
      {:send, frames, socket} ->
        Enum.each(frames, &:yaws_websockets.send(connection, &1))
        {:ok, socket}

      {:close, close, _socket} ->
        {:error, close}
    end
  end

  def handle_message({opcode, data}, socket) when opcode in [:text, :binary],
    do: socket |> SocketConnection.handle_frame(opcode, data) |> to_yaws_result()

  def handle_message({:close, status, _reason}, socket) do
    {:close, if(status in 1000..1003 or status in 3000..4999, do: status, else: :normal), socket}
  end

  def handle_info(message, socket),
    do: socket |> SocketConnection.handle_info(message) |> to_yaws_result()

  def terminate(reason, socket), do: SocketConnection.terminate(socket, reason)

  defp to_yaws_result({:send, [], socket}), do: {:noreply, socket}
  defp to_yaws_result({:send, frames, socket}), do: {:reply, frames, socket}
  defp to_yaws_result({:close, {1000, ""}, socket}), do: {:close, :normal, socket}
  defp to_yaws_result({:close, close, socket}), do: {:close, close, socket}
end
