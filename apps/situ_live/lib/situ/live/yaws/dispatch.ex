defmodule Situ.Live.Yaws.Dispatch do
  @moduledoc false
  # Called by Yaws, in the process of the connection, with each request whose head is read. Turns it into a
  # `Situ.Live.Request`, asks the endpoint, writes the answer; `:done` keeps the connection, `:closed` ends it.
  require Logger
  require Record
  alias Situ.Live.{Connections, Endpoint, Request, Response}

  @compile {:no_warn_undefined, [:yaws_api, :yaws_websockets]}

  @include "yaws/include/yaws_api.hrl"
  Record.defrecordp(:arg, Record.extract(:arg, from_lib: @include))
  @fields Record.extract(:headers, from_lib: @include)
  Record.defrecordp(:headers, @fields)
  Record.defrecordp(:http_request, Record.extract(:http_request, from_lib: @include))

  @piece 65_536

  # What the process may hold while a head is read (`Situ.Live.Yaws`) does not bind the handler.
  def dispatch(arg(opaque: ref) = arg) do
    limit = Process.flag(:max_heap_size, 0)

    try do
      case Endpoint.fetch(ref) do
        {:ok, config} -> dispatch(arg, config)
        :error -> :closed
      end
    after
      limit_again(limit)
    end
  end

  # What the handler left behind must not count against the next head.
  defp limit_again(%{size: size} = limit) do
    {:total_heap_size, held} = Process.info(self(), :total_heap_size)
    if size > 0 and held > div(size, 8), do: :erlang.garbage_collect()
    Process.flag(:max_heap_size, limit)
  end

  defp dispatch(arg, config) do
    arg(req: http_request(version: version)) = arg

    with {:ok, request} <- request(arg, config),
         {:ok, length} <- body_length(request) do
      keep? = keep?(version, request)

      case Endpoint.admit(config, request) do
        {:respond, response} ->
          keep? = keep? and length == 0
          write(arg, config, request, response, keep?)

        route ->
          with_body(arg, config, route, length, keep?)
      end
    else
      {:error, status} -> write(arg, config, %Request{}, Response.error(status), false)
    end
  end

  defp with_body(arg, config, {_, request} = route, 0, keep?),
    do: answer(arg, config, route, request, keep?)

  defp with_body(arg, config, {_, _, request} = route, 0, keep?),
    do: answer(arg, config, route, request, keep?)

  defp with_body(arg, config, route, length, keep?) do
    request = elem(route, tuple_size(route) - 1)

    with true <- length <= Endpoint.max_body(config, route) or {:error, 413},
         {:ok, body} <- read_body(arg, request, length, config.body_ms) do
      request = %{request | body: body}
      answer(arg, config, put_elem(route, tuple_size(route) - 1, request), request, keep?)
    else
      {:error, status} -> write(arg, config, request, Response.error(status), false)
    end
  end

  defp answer(arg, config, route, request, keep?) do
    case run(config, route) do
      {:upgrade, handler, handler_arg, opts, request} ->
        upgrade(arg, config, {handler, handler_arg, opts, request})

      %Response{} = response ->
        write(arg, config, request, response, keep?)
    end
  end

  # A handler that raises costs its own request only.
  defp run(config, route) do
    case Endpoint.run(config, route) do
      %Response{} = response -> response
      {:upgrade, _, _, _, _} = upgrade -> upgrade
      other -> raise "a handler must return a Situ.Live.Response, got: #{inspect(other)}"
    end
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      Response.error(500, "internal error")
  end

  # -- WebSockets

  defp upgrade(arg, config, {_, _, opts, request} = handler) do
    cond do
      Request.header(request, "sec-websocket-version") != "13" or
          Request.header(request, "sec-websocket-key") == nil ->
        response = Response.error(426) |> Response.put_header("sec-websocket-version", "13")
        write(arg, config, request, response, false)

      Connections.count(config.ref) >= config.max_sockets ->
        write(arg, config, request, Response.error(503, "too many connections"), false)

      true ->
        max = opts[:max_frame] || 65_536

        options = [
          callback: {:basic, {handler, config.ref}},
          max_frame_size: max,
          max_message_size: max,
          close_if_unmasked: true
        ]

        # Hands the connection to a process of its own and ends this one.
        :yaws_websockets.start(arg, Situ.Live.Yaws.WebSocket, options)
    end
  end

  # -- reading

  defp request(arg(headers: headers, req: req, client_ip_port: peer), config) do
    http_request(method: method, path: path) = req

    case path do
      {:abs_path, target} ->
        fields = [scheme: config.scheme, peer: peer, endpoint: config.ref]

        case Request.new(to_string(method), bytes(target), header_map(headers), fields) do
          {:ok, request} -> {:ok, request}
          {:error, :bad_request} -> {:error, 400}
        end

      _ ->
        {:error, 400}
    end
  end

  @named Keyword.keys(@fields) -- [:other, :cookie, :authorization, :host]

  defp header_map(
         headers(other: other, cookie: cookies, authorization: auth, host: host) = record
       ) do
    values = headers(record)

    named =
      for field <- @named, (value = values[field]) not in [nil, :undefined], into: %{} do
        {field |> Atom.to_string() |> String.replace("_", "-"), bytes(value)}
      end

    others =
      for {:http_header, _, name, _, value} <- other, into: named do
        {name |> to_string() |> String.downcase(), bytes(value)}
      end

    others
    |> put(
      "cookie",
      if(cookies == [], do: nil, else: cookies |> Enum.map(&bytes/1) |> Enum.join("; "))
    )
    |> put("authorization", authorization(auth))
    |> put("host", host(host))
  end

  defp put(map, _name, nil), do: map
  defp put(map, name, value), do: Map.put(map, name, value)

  defp authorization({_user, _password, original}), do: bytes(original)
  defp authorization(none) when none in [nil, :undefined], do: nil
  defp authorization(value), do: bytes(value)

  # Two host headers: neither.
  defp host(none) when none in [nil, :undefined], do: nil
  defp host({_several}), do: ""
  defp host(host), do: bytes(host)

  defp bytes(value) when is_binary(value), do: value
  defp bytes(value), do: :erlang.iolist_to_binary(value)

  defp keep?(version, request) do
    connection = request |> Request.header("connection") |> to_string() |> String.downcase()
    version == {1, 1} and connection != "close"
  end

  defp body_length(request) do
    cond do
      Request.header(request, "transfer-encoding") != nil -> {:error, 411}
      (length = Request.header(request, "content-length")) != nil -> parse_length(length)
      true -> {:ok, 0}
    end
  end

  defp parse_length(text) do
    if text =~ ~r/\A\d{1,15}\z/, do: {:ok, String.to_integer(text)}, else: {:error, 400}
  end

  defp read_body(arg(clisock: socket), request, length, body_ms) do
    expect = request |> Request.header("expect") |> to_string() |> String.downcase()
    if expect == "100-continue", do: send_bytes(socket, "HTTP/1.1 100 Continue\r\n\r\n")
    deadline = System.monotonic_time(:millisecond) + body_ms
    read(socket, length, deadline, [])
  end

  # The deadline is for all of it: a client that sends a byte now and then does not hold the connection.
  defp read(_socket, 0, _deadline, acc), do: {:ok, acc |> Enum.reverse() |> IO.iodata_to_binary()}

  defp read(socket, length, deadline, acc) do
    left_ms = deadline - System.monotonic_time(:millisecond)

    case left_ms > 0 and recv(socket, min(length, @piece), left_ms) do
      {:ok, bytes} -> read(socket, length - byte_size(bytes), deadline, [bytes | acc])
      _ -> {:error, 408}
    end
  end

  # -- writing

  defp write(arg(clisock: socket), config, request, %Response{} = response, keep?) do
    {framing, body} = framing(response.body, request, response.status, keep?)
    keep? = keep? and framing != :until_close

    head = [
      ["HTTP/1.1 ", Integer.to_string(response.status), " ", reason(response.status), "\r\n"],
      Enum.map(response.headers ++ config.headers, &header/1),
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

  # A line break in a header would start another header.
  defp header({name, value}) do
    value = :binary.replace(IO.iodata_to_binary(value), ["\r", "\n"], " ", [:global])
    [name, ": ", value, "\r\n"]
  end

  defp framing(_, _, status, _) when status in [204, 304] or status < 200, do: {:none, ""}
  defp framing({:chunks, _}, %{method: "HEAD"}, _, _), do: {:none, ""}
  defp framing({:chunks, chunks}, _, _, true), do: {:chunked, {:chunks, chunks}}
  defp framing({:chunks, chunks}, _, _, false), do: {:until_close, {:chunks, chunks}}
  defp framing({:file, _, _, n}, %{method: "HEAD"}, _, _), do: {{:length, n}, ""}
  defp framing({:file, _, _, n} = body, _, _, _), do: {{:length, n}, body}

  defp framing(body, request, _, _) do
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
    # The head is out already: an end without the last chunk tells the client that something is missing.
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
      copy(file, socket, length)
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

  defp copy(_file, _socket, 0), do: :ok

  defp copy(file, socket, length) do
    with {:ok, bytes} <- :file.read(file, min(length, @piece)),
         :ok <- :ssl.send(socket, bytes) do
      copy(file, socket, length - byte_size(bytes))
    else
      _ -> :error
    end
  end

  defp send_bytes({:ssl, socket}, bytes), do: :ssl.send(socket, bytes)
  defp send_bytes(socket, bytes), do: :gen_tcp.send(socket, bytes)

  defp recv({:ssl, socket}, n, timeout_ms), do: :ssl.recv(socket, n, timeout_ms)
  defp recv(socket, n, timeout_ms), do: :gen_tcp.recv(socket, n, timeout_ms)

  # Yaws knows the older ones.
  defp reason(421), do: "Misdirected Request"
  defp reason(status) when status in 200..417, do: :yaws_api.code_to_phrase(status)
  defp reason(status) when status in [500, 501, 502, 503], do: :yaws_api.code_to_phrase(status)
  defp reason(_), do: "Status"
end
