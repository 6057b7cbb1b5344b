defmodule Situ.Live.Yaws.ResponseWriter do
  @moduledoc false
  # Writes a `Situ.Live.Response` to a socket: head, framing, body. The kernel sends files where possible.
  require Logger
  alias Situ.Live.{Request, Response}

  @compile {:no_warn_undefined, [:yaws_api]}

  @chunk_bytes 65_536

  @type socket :: :gen_tcp.socket() | {:ssl, :ssl.sslsocket()}

  @doc "Sends `100 Continue` to a client that waits for it before it sends the body."
  @spec send_continue(socket()) :: :ok | {:error, term()}
  def send_continue(socket), do: send_bytes(socket, "HTTP/1.1 100 Continue\r\n\r\n")

  @doc "Writes `response`; returns `:done` to keep the connection or `:closed` to end it."
  @spec write_response(socket(), map(), Request.t(), Response.t(), boolean()) :: :done | :closed
  def write_response(socket, config, request, %Response{} = response, keep?) do
    {framing, body} = choose_framing(response.body, request, response.status, keep?)
    keep? = keep? and framing != :until_close

    head = [
      [
        "HTTP/1.1 ",
        Integer.to_string(response.status),
        " ",
        reason_phrase(response.status),
        "\r\n"
      ],
      Enum.map(response.headers ++ config.headers, &format_header/1),
      framing_header(framing),
      if(keep?, do: [], else: "connection: close\r\n"),
      "\r\n"
    ]

    with :ok <- send_body(socket, head, body, framing),
         true <- keep? do
      :done
    else
      _ -> :closed
    end
  end

  # A line break in a header would begin another header.
  defp format_header({name, value}) do
    value = :binary.replace(IO.iodata_to_binary(value), ["\r", "\n"], " ", [:global])
    [name, ": ", value, "\r\n"]
  end

  defp choose_framing(_, _, status, _) when status in [204, 304] or status < 200, do: {:none, ""}
  defp choose_framing({:chunks, _}, %{method: "HEAD"}, _, _), do: {:none, ""}
  defp choose_framing({:chunks, chunks}, _, _, true), do: {:chunked, {:chunks, chunks}}
  defp choose_framing({:chunks, chunks}, _, _, false), do: {:until_close, {:chunks, chunks}}
  defp choose_framing({:file, _, _, n}, %{method: "HEAD"}, _, _), do: {{:length, n}, ""}
  defp choose_framing({:file, _, _, n} = body, _, _, _), do: {{:length, n}, body}

  defp choose_framing(body, request, _, _) do
    length = {:length, IO.iodata_length(body)}
    if request.method == "HEAD", do: {length, ""}, else: {length, body}
  end

  defp framing_header({:length, n}), do: ["content-length: ", Integer.to_string(n), "\r\n"]
  defp framing_header(:chunked), do: "transfer-encoding: chunked\r\n"
  defp framing_header(_), do: []

  defp send_body(socket, head, {:file, path, from, length}, _) do
    with :ok <- send_bytes(socket, head) do
      send_file(socket, path, from, length)
    end
  end

  defp send_body(socket, head, {:chunks, chunks}, framing) do
    with :ok <- send_bytes(socket, head) do
      send_chunks(socket, chunks, framing)
    end
  end

  defp send_body(socket, head, body, _), do: send_bytes(socket, [head, body])

  defp send_chunks(socket, chunks, framing) do
    result =
      Enum.reduce_while(chunks, :ok, fn chunk, :ok ->
        case send_chunk(socket, chunk, IO.iodata_length(chunk), framing) do
          :ok -> {:cont, :ok}
          error -> {:halt, error}
        end
      end)

    if result == :ok and framing == :chunked, do: send_bytes(socket, "0\r\n\r\n"), else: result
  catch
    # The head was already sent; without the last chunk the client detects that the body is incomplete.
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      :error
  end

  defp send_chunk(_socket, _chunk, 0, _), do: :ok

  defp send_chunk(socket, chunk, n, :chunked),
    do: send_bytes(socket, [Integer.to_string(n, 16), "\r\n", chunk, "\r\n"])

  defp send_chunk(socket, chunk, _, :until_close), do: send_bytes(socket, chunk)

  defp send_file({:ssl, socket}, path, from, length) do
    File.open(path, [:read, :raw, :binary], fn file ->
      {:ok, _} = :file.position(file, from)
      send_file_chunks(file, socket, length)
    end)
    |> case do
      {:ok, result} -> result
      error -> error
    end
  end

  defp send_file(socket, path, from, length) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.sendfile(file, socket, from, length, [])
      :file.close(file)
      if result == {:ok, length}, do: :ok, else: :error
    end
  end

  defp send_file_chunks(_file, _socket, 0), do: :ok

  defp send_file_chunks(file, socket, length) do
    with {:ok, bytes} <- :file.read(file, min(length, @chunk_bytes)),
         :ok <- :ssl.send(socket, bytes) do
      send_file_chunks(file, socket, length - byte_size(bytes))
    else
      _ -> :error
    end
  end

  defp send_bytes({:ssl, socket}, bytes), do: :ssl.send(socket, bytes)
  defp send_bytes(socket, bytes), do: :gen_tcp.send(socket, bytes)

  # Yaws knows only the older status codes.
  defp reason_phrase(421), do: "Misdirected Request"
  defp reason_phrase(status) when status in 200..417, do: :yaws_api.code_to_phrase(status)

  defp reason_phrase(status) when status in [500, 501, 502, 503],
    do: :yaws_api.code_to_phrase(status)

  defp reason_phrase(_), do: "Status"
end
