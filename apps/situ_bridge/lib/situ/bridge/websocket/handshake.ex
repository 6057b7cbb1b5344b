defmodule Situ.Bridge.WebSocket.Handshake do
  @moduledoc false
  # The opening handshake of a WebSocket (RFC 6455, section 4): an HTTP request and its response. Pure.
  #
  # A page of any site may open a WebSocket to any address, but the browser sends the page's origin. Other clients send
  # no origin. Pages of this machine and pages with an origin in `origins:` are admitted.

  @salt "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
  @most 16_384

  @doc """
  Checks a request on the server. Options: `origins:`, and `protocols:` with the supported subprotocols, the preferred
  one first (`[]` accepts any and names none). Returns the response, the protocol, the path of the request, and the
  bytes after it.
  """
  @spec admit(binary(), keyword()) ::
          {:ok, iodata(), protocol :: String.t() | nil, path :: String.t(), rest :: binary()}
          | :more
          | {:refuse, iodata()}
  def admit(bytes, opts) do
    case :binary.split(bytes, "\r\n\r\n") do
      [head, rest] -> judged(head, rest, opts)
      [_] when byte_size(bytes) > @most -> refuse("431 Request Header Fields Too Large", "")
      [_] -> :more
    end
  end

  defp judged(head, rest, opts) do
    [line | lines] = String.split(head, "\r\n")
    headers = headers(lines)
    key = headers["sec-websocket-key"]

    with ["GET", path, "HTTP/1.1"] <- String.split(line, " "),
         {:upgrade, true} <- {:upgrade, upgrade?(headers) and key != nil},
         {:origin, true} <- {:origin, known?(headers["origin"], opts[:origins] || [])},
         {:ok, protocol} <- protocol(headers, opts[:protocols] || []) do
      {:ok, response(key, protocol), protocol, path, rest}
    else
      {:upgrade, false} ->
        refuse("426 Upgrade Required", "This address only serves WebSockets.\n")

      {:origin, false} ->
        refuse(
          "403 Forbidden",
          "Pages of this site may not connect; see the option `origins:`.\n"
        )

      {:error, wanted} ->
        refuse(
          "400 Bad Request",
          "Request a supported subprotocol: #{Enum.join(wanted, ", ")}.\n"
        )

      _ ->
        refuse("400 Bad Request", "")
    end
  end

  @doc "Parses the headers of a request or a response, with lower-case names."
  @spec headers([String.t()]) :: %{String.t() => String.t()}
  def headers(lines) do
    for line <- lines,
        [name, value] <- [:binary.split(line, ":")],
        into: %{},
        do: {name |> ascii() |> String.downcase(), value |> ascii() |> String.trim()}
  end

  # String functions fail on bytes that are not valid UTF-8.
  defp ascii(text), do: for(<<byte <- text>>, byte in 32..126, into: "", do: <<byte>>)

  defp upgrade?(headers), do: String.downcase(headers["upgrade"] || "") == "websocket"

  defp known?(nil, _origins), do: true

  defp known?(origin, origins) do
    host = URI.parse(origin).host
    origin in origins or host in ["localhost", "127.0.0.1", "::1"]
  rescue
    URI.Error -> false
  end

  defp protocol(_headers, []), do: {:ok, nil}

  defp protocol(headers, ours) do
    theirs =
      (headers["sec-websocket-protocol"] || "") |> String.split(",") |> Enum.map(&String.trim/1)

    case Enum.find(ours, &(&1 in theirs)) do
      nil -> {:error, ours}
      protocol -> {:ok, protocol}
    end
  end

  defp response(key, protocol) do
    [
      "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ",
      accept(key),
      if(protocol, do: ["\r\nSec-WebSocket-Protocol: ", protocol], else: []),
      "\r\n\r\n"
    ]
  end

  defp accept(key), do: Base.encode64(:crypto.hash(:sha, key <> @salt))

  @doc "Builds an HTTP response that ends the connection."
  @spec refuse(String.t(), String.t()) :: {:refuse, iodata()}
  def refuse(status, text) do
    head =
      "\r\nConnection: close\r\nContent-Type: text/plain\r\nContent-Length: #{byte_size(text)}\r\n\r\n"

    {:refuse, ["HTTP/1.1 ", status, head, text]}
  end

  @doc "Builds a client's request and its key."
  @spec request(String.t(), :inet.port_number(), String.t()) :: {iodata(), key :: String.t()}
  def request(host, port, path) do
    key = Base.encode64(:crypto.strong_rand_bytes(16))

    {[
       "GET #{path} HTTP/1.1\r\nHost: #{host}:#{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n",
       "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: #{key}\r\n\r\n"
     ], key}
  end

  @doc "Checks the response to a client's request."
  @spec accepted(binary(), key :: String.t()) ::
          {:ok, rest :: binary()} | :more | {:error, String.t()}
  def accepted(bytes, key) do
    case :binary.split(bytes, "\r\n\r\n") do
      [head, rest] ->
        [status | lines] = String.split(head, "\r\n")

        cond do
          not String.starts_with?(status, "HTTP/1.1 101") ->
            {:error, "the server responded with #{inspect(status)}"}

          headers(lines)["sec-websocket-accept"] != accept(key) ->
            {:error, "the server is not a WebSocket server"}

          true ->
            {:ok, rest}
        end

      [_] when byte_size(bytes) > @most ->
        {:error, "the response is not HTTP"}

      [_] ->
        :more
    end
  end
end
