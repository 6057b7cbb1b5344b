defmodule Situ.Live.Adapter do
  @moduledoc """
  The behaviour of a web server that carries a `Situ.Live` server. Situ has one for Yaws. The package `situ_phoenix` has
  one for Plug, so that the same pages are served by an application's own endpoint, on Bandit or Cowboy.

  An adapter converts each request to a `Situ.Live.Request` and calls `serve_request/4`, which checks, limits and
  handles the request in the same way for all adapters and calls back to read the body and to respond. A server that is
  started with `port: :none` opens no port and receives all its requests in this way:

      {:ok, server} = Situ.Live.start_link(port: :none, prefix: "/pages", routes: routes)
      config = Situ.Live.Adapter.fetch_config!(server)
      Situ.Live.Adapter.serve_request(MyAdapter, connection, config, request)

  A WebSocket is a `Situ.Live.SocketConnection` value, which the adapter's process holds and passes all frames and
  messages to.

  ## Access

  With `port: :none`, the other web server decides who may use the pages. It must do so before it calls
  `serve_request/4`, for WebSockets too. It may set the `role` of the request to `:viewer`. Host names and origins are
  still checked, against `hosts` and `origins` of the configuration (`allow/2`).
  """
  # See docs/adr/0186-another-web-server-carries-the-pages.md.
  require Logger
  alias Situ.Live.{Connections, Endpoint, Request, Response, SocketConnection}

  @typedoc "The adapter's own value for one request, for example a `Plug.Conn`."
  @type connection :: term()

  @typedoc "The configuration of a server."
  @type config :: Endpoint.t()

  @typedoc "The value that the adapter's callbacks return, which `serve_request/4` returns unchanged."
  @type result :: term()

  @doc "Reads a body of `length` bytes, within `config.body_ms` milliseconds; an error is an HTTP status."
  @callback read_body(connection(), config(), Request.t(), length :: pos_integer()) ::
              {:ok, binary(), connection()} | {:error, 400..599}

  @doc """
  Sends a response with the server's `config.headers`. `body_read?` is false if the request has a body that was not
  read, so that an HTTP/1.1 connection cannot be reused.
  """
  @callback send_response(
              connection(),
              config(),
              Request.t(),
              {Response.t(), body_read? :: boolean()}
            ) ::
              result()

  @doc """
  Turns the connection into a WebSocket with messages of at most `max_frame` bytes. Its process calls
  `Situ.Live.SocketConnection.open/1` and passes on what arrives.
  """
  @callback upgrade_connection(connection(), SocketConnection.t(), max_frame :: pos_integer()) ::
              result()

  @doc "Returns the configuration of a running server; it does not change while the server runs."
  @spec fetch_config!(Supervisor.supervisor()) :: config()
  def fetch_config!(server), do: Situ.Live.get_endpoint(server)

  @doc "Returns the configuration with the scheme, host names and origins that the other web server has."
  @spec allow(config(), scheme: String.t(), hosts: [String.t()] | :any, origins: [String.t()]) ::
          config()
  def allow(config, access), do: struct!(config, access)

  @doc "Checks and handles one request, and responds through the callbacks of `adapter`."
  @spec serve_request(module(), connection(), config(), Request.t()) :: result()
  def serve_request(adapter, connection, config, request) do
    case body_length(request) do
      {:ok, length} -> admit_request({adapter, connection, config}, request, length)
      {:error, status} -> reject_request({adapter, connection, config}, request, status)
    end
  end

  defp admit_request({adapter, connection, config} = carrier, request, length) do
    case Endpoint.admit_request(config, request) do
      {:respond, response} ->
        adapter.send_response(connection, config, request, {response, length == 0})

      route when length == 0 ->
        run_route(carrier, route)

      route ->
        read_body(carrier, route, length)
    end
  end

  defp read_body({adapter, connection, config} = carrier, route, length) do
    request = elem(route, tuple_size(route) - 1)

    with true <- length <= Endpoint.max_body(config, route) or {:error, 413},
         {:ok, body, connection} <- adapter.read_body(connection, config, request, length) do
      route = put_elem(route, tuple_size(route) - 1, %{request | body: body})
      run_route({adapter, connection, config}, route)
    else
      {:error, status} -> reject_request(carrier, request, status)
    end
  end

  defp reject_request({adapter, connection, config}, request, status),
    do: adapter.send_response(connection, config, request, {Response.error(status), false})

  defp run_route({adapter, connection, config} = carrier, route) do
    request = elem(route, tuple_size(route) - 1)

    case run_handler(config, route) do
      {:upgrade, handler, arg, opts, request} ->
        start_websocket(carrier, {handler, arg, request}, opts[:max_frame] || 65_536)

      %Response{} = response ->
        adapter.send_response(connection, config, request, {response, true})
    end
  end

  # An exception in a handler affects only its own request.
  defp run_handler(config, route) do
    case Endpoint.run_route(config, route) do
      %Response{} = response -> response
      {:upgrade, _, _, _, _} = upgrade -> upgrade
      other -> raise "a handler must return a Situ.Live.Response, got: #{inspect(other)}"
    end
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      Response.error(500, "internal error")
  end

  defp start_websocket({adapter, connection, config}, {_, _, request} = handler, max_frame) do
    cond do
      Request.get_header(request, "sec-websocket-version") != "13" or
          Request.get_header(request, "sec-websocket-key") == nil ->
        response = Response.error(426) |> Response.put_header("sec-websocket-version", "13")
        adapter.send_response(connection, config, request, {response, false})

      Connections.count(config.ref) >= config.max_sockets ->
        response = Response.error(503, "too many connections")
        adapter.send_response(connection, config, request, {response, false})

      true ->
        socket = SocketConnection.new(config.ref, handler)
        adapter.upgrade_connection(connection, socket, max_frame)
    end
  end

  defp body_length(request) do
    cond do
      Request.get_header(request, "transfer-encoding") != nil -> {:error, 411}
      (length = Request.get_header(request, "content-length")) != nil -> parse_length(length)
      true -> {:ok, 0}
    end
  end

  defp parse_length(text) do
    if text =~ ~r/\A\d{1,15}\z/, do: {:ok, String.to_integer(text)}, else: {:error, 400}
  end
end
