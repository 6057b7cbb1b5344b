defmodule Situ.Phoenix.Plug do
  @moduledoc """
  Serves a `Situ.Live` server from a Plug pipeline, on whatever web server the application runs (Bandit, Cowboy).
  `Situ.Phoenix.Router.situ_studio/2` forwards to this plug. Use it directly in a router of Plug alone:

      forward "/situ", to: Situ.Phoenix.Plug, init_opts: [recordings: "recordings"]

  Plugs before this one decide who may use the pages. They run for the WebSockets of the pages, too.

  With the option `server:`, the name of a running `Situ.Live` server that was started with `port: :none` and the
  `prefix:` of this route, it serves that server's pages.
  """
  # See docs/adr/0186-another-web-server-carries-the-pages.md.
  @behaviour Plug
  @behaviour Situ.Live.Adapter
  import Plug.Conn
  alias Situ.Live.{Adapter, Request, Response}
  alias Situ.Phoenix.Studios

  # Pages send a message at least every 30 s.
  @idle_ms 90_000
  @chunk_bytes 65_536
  @loopback_names ["localhost", "127.0.0.1", "::1"]

  @impl Plug
  def init(opts), do: opts

  @impl Plug
  def call(conn, opts) do
    opts = with {module, function, args} <- opts, do: apply(module, function, args)
    conn = split_path(conn)

    case fetch_server(conn, opts) do
      {:ok, server} -> serve(conn, Adapter.fetch_config!(server), opts)
      {:error, error} -> conn |> send_resp(500, Exception.message(error)) |> halt()
    end
  end

  # A route of `situ_studio/2` matches the rest of the path; `forward` has removed its own part already.
  defp split_path(
         %{path_params: %{"situ_path" => rest}, path_info: path, script_name: script} = conn
       ) do
    {base, rest} = Enum.split(path, length(path) - length(rest))
    %{conn | script_name: script ++ base, path_info: rest}
  end

  defp split_path(conn), do: conn

  defp fetch_server(conn, opts) do
    if opts[:server],
      do: {:ok, opts[:server]},
      else: Studios.fetch_server(join_path(conn.script_name), opts)
  end

  defp serve(conn, config, opts) do
    config = Adapter.allow(config, allowed_access(conn, opts))
    target = join_path(conn.script_name ++ conn.path_info) <> query_part(conn.query_string)
    role = if viewer?(conn, opts[:viewer?]), do: :viewer, else: :owner
    peer = {conn.remote_ip, get_peer_data(conn).port}
    fields = [scheme: config.scheme, peer: peer, role: role, endpoint: config.ref]

    # Plug would refuse the studio's scripts, because they are not requested by XMLHttpRequest. Their
    # cross-origin-resource-policy protects them from other sites.
    conn = put_private(conn, :plug_skip_csrf_protection, true)

    case Request.new(conn.method, target, request_headers(conn), fields) do
      {:ok, request} -> Adapter.serve_request(__MODULE__, conn, config, request)
      {:error, :bad_request} -> conn |> send_resp(400, "400 bad request\n") |> halt()
    end
  end

  defp viewer?(_conn, nil), do: false
  defp viewer?(conn, {module, function}), do: apply(module, function, [conn])

  # A host name that another site points at this machine (DNS rebinding) is rejected.
  defp allowed_access(conn, opts) do
    endpoint = conn.private[:phoenix_endpoint]
    own = if endpoint, do: [endpoint.host() | @loopback_names], else: :any
    origins = if endpoint, do: [endpoint.url()], else: []
    [scheme: to_string(conn.scheme), hosts: opts[:hosts] || own, origins: origins]
  end

  defp join_path(segments), do: Enum.map_join(segments, &("/" <> &1))

  defp query_part(""), do: ""
  defp query_part(query), do: "?" <> query

  defp request_headers(conn) do
    for {name, value} <- conn.req_headers, reduce: %{"host" => host_header(conn)} do
      headers when name == "host" -> headers
      headers when name == "cookie" -> Map.update(headers, name, value, &(&1 <> "; " <> value))
      headers -> Map.update(headers, name, value, &(&1 <> ", " <> value))
    end
  end

  # Plug.RewriteOn may have changed the host and port of the connection.
  defp host_header(%{host: host, port: port, scheme: scheme}) do
    host = if host =~ ~r/\A[0-9a-f:]*:[0-9a-f:]*\z/i, do: "[#{host}]", else: host
    if port == URI.default_port(to_string(scheme)), do: host, else: "#{host}:#{port}"
  end

  @impl Adapter
  def read_body(conn, config, _request, length) do
    case Plug.Conn.read_body(conn, length: length, read_timeout: config.body_ms) do
      {:ok, body, conn} when byte_size(body) == length -> {:ok, body, conn}
      # A parser has read the body already.
      {:ok, _other, _conn} -> {:error, 400}
      {:more, _part, _conn} -> {:error, 413}
      {:error, _reason} -> {:error, 408}
    end
  end

  @impl Adapter
  def send_response(conn, config, _request, {%Response{} = response, _body_read?}) do
    config.headers
    |> Enum.concat(response.headers)
    |> Enum.reduce(conn, fn {name, value}, conn -> put_header(conn, name, one_line(value)) end)
    |> send_body(response.status, response.body)
    |> halt()
  end

  defp put_header(conn, "set-cookie", value),
    do: prepend_resp_headers(conn, [{"set-cookie", value}])

  defp put_header(conn, name, value), do: put_resp_header(conn, name, value)

  defp one_line(value),
    do: :binary.replace(IO.iodata_to_binary(value), ["\r", "\n"], " ", [:global])

  defp send_body(conn, status, {:file, path, from, length}),
    do: send_file(conn, status, path, from, length)

  defp send_body(conn, status, {:chunks, chunks}) do
    Enum.reduce_while(chunks, send_chunked(conn, status), fn part, conn ->
      case send_parts(conn, IO.iodata_to_binary(part)) do
        {:ok, conn} -> {:cont, conn}
        {:error, _closed} -> {:halt, conn}
      end
    end)
  end

  defp send_body(conn, status, body), do: send_resp(conn, status, body)

  # An empty chunk would end the response.
  defp send_parts(conn, ""), do: {:ok, conn}

  defp send_parts(conn, <<part::binary-size(@chunk_bytes), rest::binary>>) do
    with {:ok, conn} <- chunk(conn, part), do: send_parts(conn, rest)
  end

  defp send_parts(conn, part), do: chunk(conn, part)

  @impl Adapter
  def upgrade_connection(conn, socket, max_frame) do
    conn
    |> WebSockAdapter.upgrade(Situ.Phoenix.Socket, socket,
      timeout: @idle_ms,
      max_frame_size: max_frame
    )
    |> halt()
  end
end
