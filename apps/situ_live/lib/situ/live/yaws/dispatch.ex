defmodule Situ.Live.Yaws.Dispatch do
  @moduledoc false
  # Yaws calls this module, in the process of the connection, with each request whose head has been read. It builds a
  # `Situ.Live.Request`, passes it to the endpoint and writes the response. `:done` keeps the connection, `:closed` ends
  # it.
  require Logger
  require Record
  alias Situ.Live.{Connections, Endpoint, Request, Response}
  alias Situ.Live.Yaws.Answer

  @compile {:no_warn_undefined, [:yaws_api, :yaws_websockets]}

  @include "yaws/include/yaws_api.hrl"
  Record.defrecordp(:arg, Record.extract(:arg, from_lib: @include))
  @fields Record.extract(:headers, from_lib: @include)
  Record.defrecordp(:headers, @fields)
  Record.defrecordp(:http_request, Record.extract(:http_request, from_lib: @include))

  @piece 65_536

  # The heap limit for reading a head (`Situ.Live.Yaws`) does not apply to the handler.
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

  # The handler's garbage must not count against the next head.
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

  # An exception in a handler affects only its own request.
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

        # Passes the connection to a new process and ends this one.
        :yaws_websockets.start(arg, Situ.Live.Yaws.WebSocket, options)
    end
  end

  defp write(arg(clisock: socket), config, request, response, keep?),
    do: Answer.write(socket, config, request, response, keep?)

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

  # If there are several host headers, none of them is used.
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
    if expect == "100-continue", do: Answer.continue(socket)
    deadline = System.monotonic_time(:millisecond) + body_ms
    read(socket, length, deadline, [])
  end

  # The deadline applies to the whole body, so that a client cannot hold the connection by sending a byte now and then.
  defp read(_socket, 0, _deadline, acc), do: {:ok, acc |> Enum.reverse() |> IO.iodata_to_binary()}

  defp read(socket, length, deadline, acc) do
    left_ms = deadline - System.monotonic_time(:millisecond)

    case left_ms > 0 and recv(socket, min(length, @piece), left_ms) do
      {:ok, bytes} -> read(socket, length - byte_size(bytes), deadline, [bytes | acc])
      _ -> {:error, 408}
    end
  end

  defp recv({:ssl, socket}, n, timeout_ms), do: :ssl.recv(socket, n, timeout_ms)
  defp recv(socket, n, timeout_ms), do: :gen_tcp.recv(socket, n, timeout_ms)
end
