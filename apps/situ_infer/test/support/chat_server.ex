defmodule Situ.Infer.Test.ChatServer do
  @moduledoc false
  # A real server on a real port that responds as the test's function says: `script.(request, n)` returns the steps
  # for the n-th request: bytes to send, `{:wait, message}` to wait for the test, `:reset` or `:close`. The process
  # that started it receives `{:request, n, request}`, and `{:gone, n}` when a client disconnects while it waits.

  def start(script, opts \\ []) do
    transport = if opts[:tls], do: :ssl, else: :gen_tcp

    options =
      [:binary, active: false, packet: :raw, reuseaddr: true, ip: {127, 0, 0, 1}] ++
        (opts[:tls] || [])

    {:ok, listener} = transport.listen(0, options)

    {:ok, {_, port}} =
      if transport == :ssl, do: :ssl.sockname(listener), else: :inet.sockname(listener)

    test = self()
    pid = spawn_link(fn -> accept(transport, listener, script, test, 1) end)
    if transport == :gen_tcp, do: :gen_tcp.controlling_process(listener, pid)

    %{
      pid: pid,
      port: port,
      url: "#{if opts[:tls], do: "https", else: "http"}://127.0.0.1:#{port}/v1"
    }
  end

  @doc "Builds a complete streamed response: the chunks, each as one event."
  def stream(pieces, opts \\ []) do
    events = for piece <- pieces, do: event(%{choices: [%{index: 0, delta: %{content: piece}}]})
    last = event(%{choices: [%{index: 0, delta: %{}, finish_reason: opts[:finish] || "stop"}]})

    [head() | Enum.map(events ++ [last] ++ usage(opts[:usage]) ++ ["data: [DONE]\n\n"], &chunk/1)] ++
      [chunk("")]
  end

  def head(type \\ "text/event-stream"),
    do: "HTTP/1.1 200 OK\r\nContent-Type: #{type}\r\nTransfer-Encoding: chunked\r\n\r\n"

  def event(map), do: "data: " <> Situ.JSON.encode(map) <> "\n\n"
  def piece(text), do: chunk(event(%{choices: [%{index: 0, delta: %{content: text}}]}))
  def chunk(bytes), do: Integer.to_string(byte_size(bytes), 16) <> "\r\n" <> bytes <> "\r\n"

  def refuse(status, message, headers \\ "") do
    body = Situ.JSON.encode(%{error: %{message: message}})
    ["HTTP/1.1 #{status} No\r\n#{headers}Content-Length: #{byte_size(body)}\r\n\r\n" <> body]
  end

  @doc "Builds a complete response of this type."
  def answer(type, body) do
    head =
      "HTTP/1.1 200 OK\r\nContent-Type: #{type}\r\nContent-Length: #{byte_size(body)}\r\n\r\n"

    [head <> body]
  end

  def json(map), do: answer("application/json", Situ.JSON.encode(map))

  defp usage(nil), do: []

  defp usage({read, written}),
    do: [event(%{choices: [], usage: %{prompt_tokens: read, completion_tokens: written}})]

  defp accept(transport, listener, script, test, n) do
    {:ok, socket} =
      if transport == :ssl, do: :ssl.transport_accept(listener), else: :gen_tcp.accept(listener)

    worker =
      spawn_link(fn ->
        receive do: (:go -> :ok)

        with {:ok, socket} <- shake(transport, socket),
             do: serve({transport, socket}, script, test, n)
      end)

    transport.controlling_process(socket, worker)
    send(worker, :go)
    accept(transport, listener, script, test, n + 1)
  end

  defp shake(:ssl, socket), do: :ssl.handshake(socket, 30_000)
  defp shake(_, socket), do: {:ok, socket}

  defp serve({transport, socket} = peer, script, test, n) do
    request = read(peer, "")
    send(test, {:request, n, request})
    Enum.each(script.(request, n), &act(&1, peer, test, n))
    transport.close(socket)
  catch
    :gone -> send(test, {:gone, n})
  end

  defp act(bytes, {transport, socket}, _, _) when is_binary(bytes) do
    if transport.send(socket, bytes) != :ok, do: throw(:gone)
  end

  defp act({:wait, message}, {transport, socket}, test, n) do
    send(test, {:waiting, n, self()})
    set(transport, socket, active: true)
    wait(message)
    set(transport, socket, active: false)
  end

  defp act(:reset, {:gen_tcp, socket}, _, _) do
    :inet.setopts(socket, linger: {true, 0})
    :gen_tcp.close(socket)
    throw(:gone)
  end

  defp wait(message) do
    receive do
      ^message -> :ok
      {closed, _} when closed in [:tcp_closed, :ssl_closed] -> throw(:gone)
      {error, _, _} when error in [:tcp_error, :ssl_error] -> throw(:gone)
    end
  end

  # A body that is not JSON (audio, images, forms) is not changed.
  defp content(""), do: nil

  defp content(body) do
    case Situ.JSON.decode(body) do
      {:ok, json} -> json
      {:error, _} -> body
    end
  end

  defp set(:gen_tcp, socket, options), do: :inet.setopts(socket, options)
  defp set(:ssl, socket, options), do: :ssl.setopts(socket, options)

  defp read({transport, socket} = peer, got) do
    with [head, body] <- String.split(got, "\r\n\r\n", parts: 2),
         [_, length] = Regex.run(~r/content-length: (\d+)/, head),
         true <- byte_size(body) == String.to_integer(length) do
      [first | lines] = String.split(head, "\r\n")
      headers = Map.new(lines, &List.to_tuple(String.split(&1, ": ", parts: 2)))
      %{first: first, headers: headers, body: content(body)}
    else
      _ ->
        case transport.recv(socket, 0, 30_000) do
          {:ok, bytes} -> read(peer, got <> bytes)
          {:error, _} -> throw(:gone)
        end
    end
  end
end
