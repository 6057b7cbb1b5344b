defmodule Situ.Bridge.WebSocket.Handshake do
  @moduledoc false
  # The opening handshake of a WebSocket (RFC 6455, section 4): an HTTP request and its response. Pure.
  #
  # A page of any site may open a WebSocket to any address, but the browser sends the page's origin. Other clients send
  # no origin. Pages of this machine and pages with an origin in `origins:` are admitted.

  @salt "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
  @max_head 16_384

  @doc """
  Checks a request on the server. Options: `origins:`, and `protocols:` with the supported subprotocols, the preferred
  one first (`[]` accepts any and names none). Returns the response, the protocol, the path of the request, and the
  bytes after it.
  """
  @spec admit_client(binary(), keyword()) ::
          {:ok, iodata(), protocol :: String.t() | nil, path :: String.t(), rest :: binary()}
          | :more
          | {:refuse, iodata()}
  def admit_client(bytes, opts) do
    case :binary.split(bytes, "\r\n\r\n") do
      [head, rest] ->
        check_request(head, rest, opts)

      [_] when byte_size(bytes) > @max_head ->
        refuse_request("431 Request Header Fields Too Large", "")

      [_] ->
        :more
    end
  end

  defp check_request(head, rest, opts) do
    [line | lines] = String.split(head, "\r\n")
    headers = parse_headers(lines)
    key = headers["sec-websocket-key"]

    with ["GET", path, "HTTP/1.1"] <- String.split(line, " "),
         {:upgrade, true} <- {:upgrade, upgrade_request?(headers) and key != nil},
         {:origin, true} <- {:origin, allowed_origin?(headers["origin"], opts[:origins] || [])},
         {:ok, protocol} <- choose_protocol(headers, opts[:protocols] || []) do
      {:ok, build_response(key, protocol), protocol, path, rest}
    else
      {:upgrade, false} ->
        refuse_request("426 Upgrade Required", "This address only serves WebSockets.\n")

      {:origin, false} ->
        refuse_request(
          "403 Forbidden",
          "Pages of this site may not connect; see the option `origins:`.\n"
        )

      {:error, supported} ->
        refuse_request(
          "400 Bad Request",
          "Request a supported subprotocol: #{Enum.join(supported, ", ")}.\n"
        )

      _ ->
        refuse_request("400 Bad Request", "")
    end
  end

  @doc "Parses the headers of a request or a response, with lower-case names."
  @spec parse_headers([String.t()]) :: %{String.t() => String.t()}
  def parse_headers(lines) do
    for line <- lines,
        [name, value] <- [:binary.split(line, ":")],
        into: %{},
        do:
          {name |> printable_ascii() |> String.downcase(),
           value |> printable_ascii() |> String.trim()}
  end

  # Functions of `String` fail on bytes that are not valid UTF-8, so only printable ASCII is kept.
  defp printable_ascii(text), do: for(<<byte <- text>>, byte in 32..126, into: "", do: <<byte>>)

  defp upgrade_request?(headers), do: String.downcase(headers["upgrade"] || "") == "websocket"

  defp allowed_origin?(nil, _origins), do: true

  defp allowed_origin?(origin, origins) do
    host = URI.parse(origin).host
    origin in origins or host in ["localhost", "127.0.0.1", "::1"]
  rescue
    URI.Error -> false
  end

  defp choose_protocol(_headers, []), do: {:ok, nil}

  defp choose_protocol(headers, supported) do
    requested =
      (headers["sec-websocket-protocol"] || "") |> String.split(",") |> Enum.map(&String.trim/1)

    case Enum.find(supported, &(&1 in requested)) do
      nil -> {:error, supported}
      protocol -> {:ok, protocol}
    end
  end

  defp build_response(key, protocol) do
    [
      "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ",
      accept_key(key),
      if(protocol, do: ["\r\nSec-WebSocket-Protocol: ", protocol], else: []),
      "\r\n\r\n"
    ]
  end

  defp accept_key(key), do: Base.encode64(:crypto.hash(:sha, key <> @salt))

  @doc "Builds an HTTP response that ends the connection."
  @spec refuse_request(String.t(), String.t()) :: {:refuse, iodata()}
  def refuse_request(status, text) do
    head =
      "\r\nConnection: close\r\nContent-Type: text/plain\r\nContent-Length: #{byte_size(text)}\r\n\r\n"

    {:refuse, ["HTTP/1.1 ", status, head, text]}
  end

  @doc "Builds a client's request and its key."
  @spec build_request(String.t(), :inet.port_number(), String.t()) ::
          {iodata(), key :: String.t()}
  def build_request(host, port, path) do
    key = Base.encode64(:crypto.strong_rand_bytes(16))

    {[
       "GET #{path} HTTP/1.1\r\nHost: #{host}:#{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n",
       "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: #{key}\r\n\r\n"
     ], key}
  end

  @doc "Checks the response to a client's request."
  @spec check_response(binary(), key :: String.t()) ::
          {:ok, rest :: binary()} | :more | {:error, String.t()}
  def check_response(bytes, key) do
    case :binary.split(bytes, "\r\n\r\n") do
      [head, rest] ->
        [status | lines] = String.split(head, "\r\n")

        cond do
          not String.starts_with?(status, "HTTP/1.1 101") ->
            {:error, "the server responded with #{inspect(status)}"}

          parse_headers(lines)["sec-websocket-accept"] != accept_key(key) ->
            {:error, "the server is not a WebSocket server"}

          true ->
            {:ok, rest}
        end

      [_] when byte_size(bytes) > @max_head ->
        {:error, "the response is not HTTP"}

      [_] ->
        :more
    end
  end
end
