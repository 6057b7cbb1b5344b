defmodule Situ.Bridge.Ros.SlaveCall do
  @moduledoc false
  # Handles one HTTP call to a node: reads the request, sends the response, and closes the connection.
  use GenServer, restart: :temporary
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Ros.XmlRpc
  alias Situ.Bridge.WebSocket.Handshake

  @timeout_ms 10_000
  @max_bytes 1_000_000

  @doc "Starts a process that handles one call with `fun`, which gets a method and its arguments."
  def start_link(fun), do: GenServer.start_link(__MODULE__, fun)

  @impl true
  def init(fun), do: {:ok, %{fun: fun, received_bytes: ""}, @timeout_ms}

  @impl true
  def handle_info({:adopt, tcp}, state) do
    :inet.setopts(tcp, active: :once)
    {:noreply, state, @timeout_ms}
  end

  def handle_info({:tcp, tcp, bytes}, state) do
    received_bytes = state.received_bytes <> bytes

    case parse_body(received_bytes) do
      {:ok, body} ->
        :gen_tcp.send(tcp, build_reply(body, state.fun))
        {:stop, :normal, state}

      :more when byte_size(received_bytes) <= @max_bytes ->
        :inet.setopts(tcp, active: :once)
        {:noreply, %{state | received_bytes: received_bytes}, @timeout_ms}

      _ ->
        {:stop, :normal, state}
    end
  end

  # The connection was closed, broken or too slow.
  def handle_info(_other, state), do: {:stop, :normal, state}

  @doc """
  Returns the body of a complete HTTP request.

      iex> Situ.Bridge.Ros.SlaveCall.parse_body("POST / HTTP/1.1\\r\\nContent-length: 2\\r\\n\\r\\nab")
      {:ok, "ab"}
  """
  @spec parse_body(binary()) :: {:ok, binary()} | :more | :error
  def parse_body(received_bytes) do
    with [head, rest] <- :binary.split(received_bytes, "\r\n\r\n"),
         [_ | lines] <- String.split(head, "\r\n"),
         {n, ""} when n >= 0 <-
           Integer.parse(Handshake.parse_headers(lines)["content-length"] || "") do
      case rest do
        <<body::binary-pinned_size(n), _::binary>> -> {:ok, body}
        _ -> :more
      end
    else
      [_] -> :more
      _ -> :error
    end
  end

  defp build_reply(body, fun) do
    case XmlRpc.read_request(body) do
      {:ok, method, arguments} ->
        fun.(method, arguments) |> XmlRpc.encode_response() |> build_http("200 OK")

      {:error, why} ->
        build_http(why, "400 Bad Request")
    end
  end

  defp build_http(body, status) do
    length = Integer.to_string(IO.iodata_length(body))

    [
      "HTTP/1.0 ",
      status,
      "\r\nContent-Type: text/xml\r\nContent-Length: ",
      length,
      "\r\n\r\n",
      body
    ]
  end
end
