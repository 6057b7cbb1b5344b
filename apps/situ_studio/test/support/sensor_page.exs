defmodule Situ.Studio.Test.SensorPage do
  # A sensor's page: a small WebSocket client whose frames are masked like a browser's.
  alias Situ.JSON

  def connect(port, path, headers \\ []) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])

    :ok =
      :gen_tcp.send(socket, [
        "GET #{path} HTTP/1.1\r\nHost: 127.0.0.1:#{port}\r\nOrigin: http://127.0.0.1:#{port}\r\n",
        Enum.map(headers, fn {name, value} -> "#{name}: #{value}\r\n" end),
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
      ])

    {head(socket, ""), socket}
  end

  defp head(socket, got) do
    if String.ends_with?(got, "\r\n\r\n") do
      got
    else
      {:ok, byte} = :gen_tcp.recv(socket, 1, 30_000)
      head(socket, got <> byte)
    end
  end

  # Returns an accepted connection and its first frame. The previous page may not have left yet.
  def again(connect) do
    {_, socket} = connect.()

    case pull(socket) do
      {8, _} ->
        receive do
        after
          20 -> again(connect)
        end

      first ->
        {first, socket}
    end
  end

  def push(socket, opcode, data) do
    length =
      cond do
        byte_size(data) < 126 -> <<1::1, byte_size(data)::7>>
        byte_size(data) < 65_536 -> <<1::1, 126::7, byte_size(data)::16>>
        true -> <<1::1, 127::7, byte_size(data)::64>>
      end

    :gen_tcp.send(socket, [<<1::1, 0::3, opcode::4>>, length, <<0::32>>, data])
  end

  def text(socket, map), do: push(socket, 1, JSON.encode(map))

  def pull(socket) do
    with {:ok, <<_::4, opcode::4, 0::1, length::7>>} <- :gen_tcp.recv(socket, 2, 30_000),
         {:ok, length} <- length(socket, length),
         {:ok, data} <-
           if(length == 0, do: {:ok, ""}, else: :gen_tcp.recv(socket, length, 30_000)),
         do: {opcode, data}
  end

  defp length(socket, 126) do
    {:ok, <<n::16>>} = :gen_tcp.recv(socket, 2, 30_000)
    {:ok, n}
  end

  defp length(_socket, n), do: {:ok, n}

  def json(socket) do
    case pull(socket) do
      {1, text} -> text |> JSON.decode() |> elem(1)
      {_, _} -> json(socket)
    end
  end

  def closed?(socket) do
    case pull(socket) do
      {8, _} -> true
      {:error, reason} -> reason == :closed
      {_, _} -> closed?(socket)
    end
  end

  def now_ms, do: System.os_time(:microsecond) / 1_000

  def poll(fun) do
    unless fun.() do
      receive do
      after
        20 -> poll(fun)
      end
    end
  end
end
