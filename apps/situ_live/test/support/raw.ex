defmodule Situ.Live.Raw do
  @moduledoc false
  # HTTP and WebSocket written by hand, so that tests can break any rule.
  import Bitwise

  def connect(port) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
    socket
  end

  @doc "Sends one request as text and returns the response as `{status, headers, body}`."
  def request(port, text) do
    socket = connect(port)
    :ok = :gen_tcp.send(socket, text)
    answer = response(socket)
    :gen_tcp.close(socket)
    answer
  end

  def get(port, path, headers \\ []), do: request(port, head("GET", path, port, headers))

  def post(port, path, body, headers \\ []) do
    headers = [{"content-length", "#{byte_size(body)}"} | headers]
    request(port, head("POST", path, port, headers) <> body)
  end

  def head(method, path, port, headers) do
    headers =
      if List.keymember?(headers, "host", 0),
        do: headers,
        else: [{"host", "localhost:#{port}"} | headers]

    "#{method} #{path} HTTP/1.1\r\n" <>
      Enum.map_join(headers, fn {k, v} -> "#{k}: #{v}\r\n" end) <> "\r\n"
  end

  @doc "Returns all bytes up to a mark."
  def collect(port, text, mark) do
    socket = connect(port)
    :ok = :gen_tcp.send(socket, text)
    {:ok, before, _} = until(socket, mark, "")
    :gen_tcp.close(socket)
    before <> mark
  end

  # How long to wait for an expected response in ms; a busy machine may be slow.
  @patience 30_000

  @doc "Returns `:closed` if the server ends the connection without sending, `:timeout` if it does neither."
  def response(socket, method \\ "GET") do
    case until(socket, "\r\n\r\n", "") do
      {:ok, head, rest} ->
        ["HTTP/1.1 " <> <<status::binary-3, _::binary>> | lines] = String.split(head, "\r\n")

        headers =
          Map.new(lines, fn line ->
            [name, value] = String.split(line, ": ", parts: 2)
            {String.downcase(name), value}
          end)

        length = String.to_integer(headers["content-length"] || "0")
        body = if method == "HEAD", do: "", else: exactly(socket, rest, length)
        {String.to_integer(status), headers, body}

      ended ->
        ended
    end
  end

  defp until(socket, mark, seen) do
    case :binary.split(seen, mark) do
      [head, rest] ->
        {:ok, head, rest}

      [_] ->
        case :gen_tcp.recv(socket, 0, @patience) do
          {:ok, more} -> until(socket, mark, seen <> more)
          {:error, :timeout} -> :timeout
          {:error, _} -> :closed
        end
    end
  end

  defp exactly(_socket, bytes, n) when byte_size(bytes) >= n, do: binary_part(bytes, 0, n)

  defp exactly(socket, bytes, n) do
    {:ok, more} = :gen_tcp.recv(socket, n - byte_size(bytes), @patience)
    bytes <> more
  end

  @doc "Upgrades the connection; returns `{:ok, socket}` or the rejection."
  def upgrade(port, path, headers \\ []) do
    socket = connect(port)

    headers =
      [
        {"upgrade", "websocket"},
        {"connection", "Upgrade"},
        {"sec-websocket-version", "13"},
        {"sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="}
      ] ++ headers

    :ok = :gen_tcp.send(socket, head("GET", path, port, headers))

    case response(socket) do
      {101, answer, _} ->
        "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=" = answer["sec-websocket-accept"]
        {:ok, socket}

      refused ->
        refused
    end
  end

  def send_text(socket, text), do: :gen_tcp.send(socket, frame(1, text))

  @doc "Builds a masked frame, as browsers send them."
  def frame(opcode, payload, fin \\ 1) do
    mask = <<1, 2, 3, 4>>
    n = byte_size(payload)

    length =
      cond do
        n < 126 -> <<1::1, n::7>>
        n < 65_536 -> <<1::1, 126::7, n::16>>
        true -> <<1::1, 127::7, n::64>>
      end

    masked =
      for {c, i} <- Enum.with_index(:binary.bin_to_list(payload)),
          into: <<>>,
          do: <<bxor(c, :binary.at(mask, rem(i, 4)))>>

    <<fin::1, 0::3, opcode::4, length::binary, mask::binary, masked::binary>>
  end

  @doc "Returns the next frame as `{:text | :binary | :close | ..., payload}`, or `:closed`."
  def receive_frame(socket, timeout \\ @patience) do
    with {:ok, <<_fin::1, 0::3, opcode::4, 0::1, short::7>>} <- :gen_tcp.recv(socket, 2, timeout),
         {:ok, n} <- length(socket, short),
         {:ok, payload} <- payload(socket, n) do
      {name(opcode), payload}
    else
      {:error, :timeout} -> :timeout
      {:error, _} -> :closed
    end
  end

  defp length(socket, 126),
    do: with({:ok, <<n::16>>} <- :gen_tcp.recv(socket, 2, @patience), do: {:ok, n})

  defp length(socket, 127),
    do: with({:ok, <<n::64>>} <- :gen_tcp.recv(socket, 8, @patience), do: {:ok, n})

  defp length(_, n), do: {:ok, n}

  defp payload(_socket, 0), do: {:ok, ""}
  defp payload(socket, n), do: :gen_tcp.recv(socket, n, @patience)

  defp name(1), do: :text
  defp name(2), do: :binary
  defp name(8), do: :close
  defp name(9), do: :ping
  defp name(10), do: :pong
end
