defmodule Situ.Live do
  @moduledoc """
  Serves web pages whose state lives on the server and that use the stock `phoenix_live_view` JavaScript client. It
  includes the HTTP and WebSocket server, and does not depend on streams or stores.

      defmodule Hello do
        use Situ.Live.View

        def mount(_params, _session, socket), do: {:ok, assign(socket, n: 0)}
        def handle_event("inc", _params, socket), do: {:noreply, update(socket, :n, &(&1 + 1))}

        def render(assigns) do
          ~H\"\"\"
          <button phx-click="inc">{@n}</button>
          \"\"\"
        end
      end

      routes = [
        {:live, "/", Hello},
        {:static, "/assets", {:my_app, "priv/static"}},
        {:get, "/data/:stream", &MyData.window/1},
        {:socket, "/live/data", MyFrames, :any_term}
      ]

      children = [{Situ.Live, port: 4040, routes: routes, layout: &MyLayout.root/1}]

  | to write | see |
  |---|---|
  | a page | `Situ.Live.View` (callbacks), `Situ.Live.Socket` (its state), `Situ.Live.JS` (commands of the browser) |
  | templates | `Situ.Live.Component`: `~H`, function components, slots, islands |
  | a handler of HTTP requests | `Situ.Live.Request`, `Situ.Live.Response` |
  | a handler of a WebSocket | `Situ.Live.SocketHandler` |
  | tests without a browser | `Situ.Live.Test` |

  ## Routes

  Routes are matched in their order.

  | route | serves |
  |---|---|
  | `{:live, path, View}`, `{:live, path, View, opts}` | a page: a view in the layout |
  | `{:get, path, handler}` or `:post`, `:put`, `:patch`, `:delete`, `:any` (or with `opts`) | the handler's response |
  | `{:static, path, dir}`, `{:static, path, {app, dir}}`, `{:static, path, dir, opts}` | files in `dir` (GET, HEAD) |
  | `{:socket, path, Module, arg}`, `{:socket, path, Module, arg, opts}` | a WebSocket (`Situ.Live.SocketHandler`) |

  A path is matched segment by segment: `:name` matches one segment, `*rest` all remaining ones. Both are in the
  request's `params` (a view's `params`). A handler is a function of one argument (the `Situ.Live.Request`), or
  `{Module, arg}`, for which the server calls `Module.call(request, arg)`. It returns a `Situ.Live.Response`.

  Options of `:live`: `action:` (the assign `live_action` of the view), `session:` (a JSON-able map, or a function that
  computes it from the request; signed into the page and passed to `mount/3`), `layout:` (replaces the server's layout).
  Options of the handlers: `max_body:` (bytes). Options of `:static`: `cache:` (the `cache-control` header). Options of
  `:socket`: `max_frame:` (bytes of an incoming message, default 65,536).

  ## The page's script

      import {Socket} from "phoenix"
      import {LiveSocket} from "phoenix_live_view"
      import {SituFlow, connectParams, domCallbacks} from "situ_live"  // apps/situ_live/assets/js/situ_live.js

      const options = {params: connectParams, dom: domCallbacks, hooks: {SituFlow, ...mine}}
      new LiveSocket("/live", Socket, options).connect()

  `SituFlow` acknowledges each diff that the server sends on its own initiative, so that only one is in flight. Pages
  work without it, but a slow browser may lag. `domCallbacks` keeps the entries of a form without `phx-change`
  when the page changes. The stock client alone keeps only the focused field. The layout is a component that receives
  `@page_title` and `@inner_content` and writes the `<html>` element, with a `<script defer src=...>`. The content
  security policy blocks inline scripts.

  ## Limits and access control

  The server listens on `127.0.0.1` by default. On any other address a token is required; unless one is given, a new
  one is generated at each start. `url/2` returns the address with the token, and opening it sets a cookie. Every
  request is checked for its host name (against DNS rebinding), its token, and, where it matters, its origin.
  Request heads (about 128 KiB), bodies, frames, the number of connections and waiting times are limited.

  ## Options

    * `:routes` - see *Routes* above; required
    * `:port` - default 4040; 0 picks a free port (see `port/1`). `:none` opens no port: another web server passes its
      requests on and decides who may use the pages (`Situ.Live.Adapter`)
    * `:ip` - the address to listen on, default `{127, 0, 0, 1}`
    * `:token` - `:auto` (default: none on a loopback address, random elsewhere), a string, or `:none` (loopback only)
    * `:viewer_token` - a second token for view-only access: `:auto` (default: random if the server has a token), a
      string (the server then has a token, too), or `:none`. Requests with it have the `role` `:viewer`
      (`Situ.Live.Request`). The views decide what a viewer may do; their `session` may be a function of the request
    * `:secret` - signs the pages; random at each start by default, so open pages reload after a restart
    * `:layout` - the component that writes the page around a view
    * `:hosts` - host names that the server accepts: `:any`, or a list; default the loopback names on a loopback
      address, `:any` elsewhere
    * `:origins` - other origins that may connect, such as `"https://lab.example.org"`
    * `:public` - the address under which browsers reach the server through a proxy, such as
      `"https://lab.example.org/studio"`. Its host and origin are accepted, its path is stripped from requests, and
      cookies, redirects and `url/2` use it
    * `:prefix` - only the path of such an address, such as `"/studio"`, for a proxy under the server's own host name
    * `:images` - additional origins from which pages may load images, such as `"https://tiles.example.org"`
    * `:headers` - headers added to every response
    * `:max_body`, `:max_frame` - bytes, default 1,000,000 each; `:max_sockets` - concurrent WebSockets, default 500
    * `:body_ms` - the maximum time to receive a complete body, default 30,000
    * `:flow` - `interval_ms:` between diffs that the server sends on its own initiative (default 33)
    * `:tls` - `certfile:` and `keyfile:`
    * `:name` - a registered name of the server's supervisor
  """
  use Supervisor
  alias Situ.Error
  alias Situ.Live.{Endpoint, Listener, PublicAddress, Route, Yaws}

  @loopback_names ["localhost", "127.0.0.1", "::1"]
  @option_names [
                  :public,
                  :prefix,
                  :routes,
                  :port,
                  :ip,
                  :token,
                  :viewer_token,
                  :secret,
                  :layout,
                  :hosts,
                  :origins,
                  :headers,
                  :max_body
                ] ++
                  [:max_frame, :max_sockets, :body_ms, :flow, :tls, :name, :images]

  @security_headers [
    {"x-content-type-options", "nosniff"},
    {"referrer-policy", "no-referrer"},
    {"x-frame-options", "SAMEORIGIN"},
    {"cross-origin-resource-policy", "same-origin"}
  ]

  @doc "Returns a child spec whose `id` contains the name or the port, so that several servers fit in one supervisor."
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  def child_spec(opts) do
    id = {__MODULE__, opts[:name] || opts[:port] || 4040}
    %{id: id, start: {__MODULE__, :start_link, [opts]}, type: :supervisor}
  end

  @doc """
  Starts a server. Returns `{:error, %Situ.Error{}}` for runtime problems such as a port in use; raises
  `ArgumentError` for an invalid option.
  """
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    case Keyword.keys(opts) -- @option_names do
      [] ->
        :ok

      unknown ->
        raise ArgumentError,
              "unknown options #{inspect(unknown)}; valid options: #{inspect(@option_names)}"
    end

    start_server(opts, if(opts[:port] == 0, do: 5, else: 1))
  end

  # Another program may take the free port before the server listens on it.
  defp start_server(opts, tries) do
    with {:ok, config} <- build_config(opts),
         options = Keyword.take(opts, [:name]),
         {:error, %Error{code: :port_in_use}} when tries > 1 <-
           unwrap_start_result(Supervisor.start_link(__MODULE__, {config, opts[:tls]}, options)) do
      start_server(opts, tries - 1)
    end
  end

  defp unwrap_start_result({:error, {:shutdown, {:failed_to_start_child, _, %Error{} = error}}}),
    do: {:error, error}

  defp unwrap_start_result(result), do: result

  defp build_config(opts) do
    ip = Keyword.get(opts, :ip, {127, 0, 0, 1})
    # A server without a port is as private as the web server that passes requests to it.
    loopback? = loopback_address?(ip) or opts[:port] == :none

    with {:ok, port} <- resolve_port(opts, ip),
         {:ok, public} <- parse_address(opts[:public], opts[:prefix]),
         viewer = Keyword.get(opts, :viewer_token, :auto),
         {:ok, token} <-
           resolve_token(Keyword.get(opts, :token, :auto), loopback? and not is_binary(viewer)),
         {:ok, viewer} <- resolve_viewer_token(viewer, token) do
      {:ok,
       %Endpoint{
         ref: make_ref(),
         routes: opts |> Keyword.fetch!(:routes) |> Route.compile(),
         secret: opts[:secret] || :crypto.strong_rand_bytes(32),
         ip: ip,
         port: port,
         scheme: if(opts[:tls], do: "https", else: "http"),
         token: token,
         viewer: viewer,
         hosts: allowed_hosts(opts[:hosts], loopback?, public),
         public: public,
         layout: opts[:layout],
         origins: (opts[:origins] || []) ++ PublicAddress.allowed_origins(public),
         images: opts[:images] || [],
         headers: @security_headers ++ (opts[:headers] || []),
         max_body: opts[:max_body] || 1_000_000,
         body_ms: opts[:body_ms] || 30_000,
         max_frame: opts[:max_frame] || 1_000_000,
         max_sockets: opts[:max_sockets] || 500,
         flow: Map.new(opts[:flow] || [])
       }}
    end
  end

  defp parse_address(public, nil), do: PublicAddress.parse(public)
  defp parse_address(nil, prefix), do: PublicAddress.parse_prefix(prefix)

  defp parse_address(public, prefix) do
    {:error,
     Error.new(:bad_prefix, "both a public address and a prefix are given",
       why: "the path of the public address is the prefix",
       fix: "give only public: #{inspect("#{public}#{prefix}")}"
     )}
  end

  defp allowed_hosts(nil, false, _), do: :any
  defp allowed_hosts(:any, _, _), do: :any

  defp allowed_hosts(names, _, public),
    do: (names || @loopback_names) ++ PublicAddress.allowed_hosts(public)

  defp resolve_port(opts, ip) do
    case Keyword.get(opts, :port, 4040) do
      0 -> Yaws.free_port(ip)
      port when port in 1..65_535 or port == :none -> {:ok, port}
      other -> raise ArgumentError, "port: must be 0 to 65535 or :none, got: #{inspect(other)}"
    end
  end

  defp loopback_address?({127, _, _, _}), do: true
  defp loopback_address?({0, 0, 0, 0, 0, 0, 0, 1}), do: true
  defp loopback_address?(_), do: false

  defp resolve_token(:auto, true), do: {:ok, nil}
  defp resolve_token(:none, true), do: {:ok, nil}

  defp resolve_token(:auto, false),
    do: {:ok, Base.url_encode64(:crypto.strong_rand_bytes(18), padding: false)}

  defp resolve_token(text, _) when is_binary(text) and byte_size(text) >= 8, do: {:ok, text}

  defp resolve_token(:none, false) do
    {:error,
     Error.new(
       :token_required,
       "a token is required when the server is not on a loopback address",
       fix: "omit token: to have one generated, or give a token of at least 8 characters"
     )}
  end

  defp resolve_token(text, _) when is_binary(text) do
    {:error, Error.new(:weak_token, "a token must have at least 8 characters")}
  end

  defp resolve_viewer_token(_, nil), do: {:ok, nil}
  defp resolve_viewer_token(:none, _token), do: {:ok, nil}
  defp resolve_viewer_token(:auto, _token), do: resolve_token(:auto, false)

  defp resolve_viewer_token(same, same) do
    {:error,
     Error.new(:weak_token, "the viewer token is the same as the owner's token",
       fix: "give different values for token: and viewer_token:"
     )}
  end

  defp resolve_viewer_token(text, _token), do: resolve_token(text, false)

  @impl true
  def init({config, tls}) do
    views = {:via, Registry, {Situ.Live.Registry, {config.ref, :views}}}

    children = [
      {DynamicSupervisor, name: views, strategy: :one_for_one},
      {Listener, {config, tls}}
    ]

    Supervisor.init(children, strategy: :rest_for_one)
  end

  @doc "Returns the port that a server listens on, or `:none`."
  @spec port(Supervisor.supervisor()) :: :inet.port_number() | :none
  def port(server), do: get_endpoint(server).port

  @doc """
  Returns the URL of a path, including the token if the server has one. Without a port and a public address, it is a
  path only.
  """
  @spec url(Supervisor.supervisor(), String.t()) :: String.t()
  def url(server, path \\ "/") do
    config = get_endpoint(server)
    build_url(config, path, config.token)
  end

  @doc "Returns the view-only URL of a path, or `nil` if the server has no viewer token."
  @spec viewer_url(Supervisor.supervisor(), String.t()) :: String.t() | nil
  def viewer_url(server, path \\ "/") do
    config = get_endpoint(server)
    if config.viewer, do: build_url(config, path, config.viewer)
  end

  @doc "Returns the viewer token of the view's server, or `nil` if there is none."
  @spec viewer_token(Situ.Live.Socket.t()) :: String.t() | nil
  def viewer_token(%{endpoint: ref}) do
    case Endpoint.fetch_config(ref) do
      {:ok, config} -> config.viewer
      :error -> nil
    end
  end

  defp build_url(config, path, token) do
    query = if token, do: "?token=#{URI.encode_www_form(token)}", else: ""
    "#{base_url(config)}#{path}#{query}"
  end

  defp base_url(%{public: %{url: url}}) when url != nil, do: url
  defp base_url(%{port: :none, public: public}), do: PublicAddress.base_path(public)

  defp base_url(%{public: public} = config) do
    base = PublicAddress.base_path(public)
    "#{config.scheme}://#{url_host(config.ip)}:#{config.port}#{base}"
  end

  defp url_host({127, 0, 0, 1}), do: "localhost"
  defp url_host({0, 0, 0, 0, 0, 0, 0, 1}), do: "localhost"

  # A server on all interfaces expects remote visitors, so its URL contains this machine's host name.
  defp url_host(ip) when ip in [{0, 0, 0, 0}, {0, 0, 0, 0, 0, 0, 0, 0}] do
    case :inet.gethostname() do
      {:ok, name} -> to_string(name)
    end
  end

  defp url_host(ip) when tuple_size(ip) == 8, do: "[#{:inet.ntoa(ip)}]"
  defp url_host(ip), do: "#{:inet.ntoa(ip)}"

  @doc false
  def get_endpoint(server) do
    server
    |> Supervisor.which_children()
    |> Enum.find_value(fn {id, pid, _, _} -> id == Listener && Listener.get_endpoint(pid) end)
  end
end
