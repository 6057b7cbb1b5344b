defmodule Situ.Live do
  @moduledoc """
  Web pages that live on the server, spoken to by the stock `phoenix_live_view` JavaScript client; and the HTTP and
  WebSocket
  server below them. Knows nothing of streams or stores.

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
        {:get, "/data/:stream", &MyData.window/1},      # Situ.Live.Request -> Situ.Live.Response
        {:socket, "/live/data", MyFrames, :any_term}    # Situ.Live.SocketHandler
      ]

      children = [{Situ.Live, port: 4040, routes: routes, layout: &MyLayout.root/1}]

  The pieces: `Situ.Live.View` (callbacks), `Situ.Live.Template` (`~H`), `Situ.Live.Component` (function components,
  slots,
  islands), `Situ.Live.Socket` (assign, push_event, push_patch, streams ...), `Situ.Live.JS` (commands),
  `Situ.Live.Route`
  (routes), `Situ.Live.Request` and `Situ.Live.Response` (HTTP), `Situ.Live.SocketHandler` (WebSockets of your own),
  `Situ.Live.Token`, `Situ.Live.Test` (tests of views without a browser).

  ## The page's script

      import {Socket} from "phoenix"
      import {LiveSocket} from "phoenix_live_view"
      import {SituFlow, connectParams} from "situ_live"       // apps/situ_live/assets/js/situ_live.js

      new LiveSocket("/live", Socket, {params: connectParams, hooks: {SituFlow, ...mine}}).connect()

  `SituFlow` acknowledges each diff that the server sent by itself, so that only one is under way; without it nothing
  breaks,
  but a slow browser may fall behind. The layout is a component that gets `@page_title` and `@inner_content` and
  writes the
  `<html>` element, with a `<script defer src=...>`: scripts inside the page are refused by its content security policy.

  ## Limits and refusals

  The server listens on `127.0.0.1` unless told otherwise; elsewhere a token is required, made new at each start
  unless given:
  `url/2` returns the address with it, opening that sets a cookie. Every request is checked for its host name (against
  DNS rebinding), token, and, where it matters, origin. Heads (to about 128 KiB), bodies, frames, numbers of
  connections and
  waiting times are bounded.

  ## Options

    * `:routes` - see `Situ.Live.Route`; required
    * `:port` - default 4040; 0 takes a free one (see `port/1`)
    * `:ip` - the address to listen on, default `{127, 0, 0, 1}`
    * `:token` - `:auto` (default: none on a loopback address, random elsewhere), text, or `:none` (loopback only)
    * `:viewer_token` - a second token for those who may only look: `:auto` (default: random where there is a token),
      text (then there is a token, too), or `:none`. Requests that come with it have the `role` `:viewer`
      (`Situ.Live.Request`); what these may do is up to the views, whose `session` may be a function of the request
    * `:secret` - signs the pages; random at each start by default, after which open pages load themselves again
    * `:layout` - the component that writes the page around a view
    * `:hosts` - names the server answers for: `:any`, or a list; default the loopback names there, `:any` elsewhere
    * `:origins` - foreign origins that may connect, such as `"https://lab.example.org"`
    * `:public` - the address under which browsers reach the server through a proxy, such as
      `"https://lab.example.org/studio"`: its host and origin are let in, its path is taken off requests, and cookies,
      redirects and `url/2` are made for it
    * `:images` - further origins that pictures of the pages may come from, such as `"https://tiles.example.org"`
    * `:headers` - headers added to every response
    * `:max_body`, `:max_frame` - bytes, default 1,000,000 each; `:max_sockets` - WebSockets at a time, default 500
    * `:body_ms` - how long the whole of a body may take to come, default 30,000
    * `:flow` - `interval_ms:` between diffs the server sends by itself (default 33)
    * `:tls` - `certfile:` and `keyfile:`
    * `:name` - a registered name of the server's supervisor
  """
  use Supervisor
  alias Situ.Error
  alias Situ.Live.{Endpoint, Listener, Public, Route, Yaws}

  @loopback_names ["localhost", "127.0.0.1", "::1"]
  @known [
           :public,
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

  @doc "A child of a supervision tree; `id:` is the name or the port, so that several fit."
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  def child_spec(opts) do
    id = {__MODULE__, opts[:name] || opts[:port] || 4040}
    %{id: id, start: {__MODULE__, :start_link, [opts]}, type: :supervisor}
  end

  @doc """
  Starts a server. A port in use, a missing certificate ... is `{:error, %Situ.Error{}}`; a wrong option raises
  `ArgumentError`.
  """
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    case Keyword.keys(opts) -- @known do
      [] ->
        :ok

      unknown ->
        raise ArgumentError, "unknown options #{inspect(unknown)}; known: #{inspect(@known)}"
    end

    start(opts, if(opts[:port] == 0, do: 5, else: 1))
  end

  # A free port may be taken by another before it is listened on.
  defp start(opts, tries) do
    with {:ok, config} <- config(opts),
         options = Keyword.take(opts, [:name]),
         {:error, %Error{code: :port_in_use}} when tries > 1 <-
           started(Supervisor.start_link(__MODULE__, {config, opts[:tls]}, options)) do
      start(opts, tries - 1)
    end
  end

  defp started({:error, {:shutdown, {:failed_to_start_child, _, %Error{} = error}}}),
    do: {:error, error}

  defp started(result), do: result

  defp config(opts) do
    ip = Keyword.get(opts, :ip, {127, 0, 0, 1})
    loopback? = loopback?(ip)

    with {:ok, port} <- port_of(opts, ip),
         {:ok, public} <- Public.parse(opts[:public]),
         viewer = Keyword.get(opts, :viewer_token, :auto),
         {:ok, token} <-
           token(Keyword.get(opts, :token, :auto), loopback? and not is_binary(viewer)),
         {:ok, viewer} <- viewer(viewer, token) do
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
         hosts: hosts(opts[:hosts], loopback?, public),
         public: public,
         layout: opts[:layout],
         origins: (opts[:origins] || []) ++ Public.origins(public),
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

  defp hosts(nil, false, _), do: :any
  defp hosts(:any, _, _), do: :any
  defp hosts(names, _, public), do: (names || @loopback_names) ++ Public.hosts(public)

  defp port_of(opts, ip) do
    case Keyword.get(opts, :port, 4040) do
      0 -> Yaws.free_port(ip)
      port when port in 1..65_535 -> {:ok, port}
      other -> raise ArgumentError, "port: takes 0 to 65535, got: #{inspect(other)}"
    end
  end

  defp loopback?({127, _, _, _}), do: true
  defp loopback?({0, 0, 0, 0, 0, 0, 0, 1}), do: true
  defp loopback?(_), do: false

  defp token(:auto, true), do: {:ok, nil}
  defp token(:none, true), do: {:ok, nil}

  defp token(:auto, false),
    do: {:ok, Base.url_encode64(:crypto.strong_rand_bytes(18), padding: false)}

  defp token(text, _) when is_binary(text) and byte_size(text) >= 8, do: {:ok, text}

  defp token(:none, false) do
    {:error,
     Error.new(:token_required, "a server that others can reach needs a token",
       fix: "leave token: out (one is made), or give one of 8 characters or more"
     )}
  end

  defp token(text, _) when is_binary(text) do
    {:error, Error.new(:weak_token, "a token has 8 characters or more")}
  end

  defp viewer(_, nil), do: {:ok, nil}
  defp viewer(:none, _token), do: {:ok, nil}
  defp viewer(:auto, _token), do: token(:auto, false)

  defp viewer(same, same) do
    {:error,
     Error.new(:weak_token, "those who may only look need a token of their own",
       fix: "give token: and viewer_token: that differ"
     )}
  end

  defp viewer(text, _token), do: token(text, false)

  @impl true
  def init({config, tls}) do
    views = {:via, Registry, {Situ.Live.Registry, {config.ref, :views}}}

    children = [
      {DynamicSupervisor, name: views, strategy: :one_for_one},
      {Listener, {config, tls}}
    ]

    Supervisor.init(children, strategy: :rest_for_one)
  end

  @doc "The port a server listens on."
  @spec port(Supervisor.supervisor()) :: :inet.port_number()
  def port(server), do: endpoint(server).port

  @doc "The address of a path, with the token when there is one."
  @spec url(Supervisor.supervisor(), String.t()) :: String.t()
  def url(server, path \\ "/") do
    config = endpoint(server)
    address(config, path, config.token)
  end

  @doc "The address of a path for one who may only look; `nil` where the server has no token for that."
  @spec viewer_url(Supervisor.supervisor(), String.t()) :: String.t() | nil
  def viewer_url(server, path \\ "/") do
    config = endpoint(server)
    if config.viewer, do: address(config, path, config.viewer)
  end

  @doc "The token of those who may only look, as a view of the server may tell it; `nil` where there is none."
  @spec viewer_token(Situ.Live.Socket.t()) :: String.t() | nil
  def viewer_token(%{endpoint: ref}) do
    case Endpoint.fetch(ref) do
      {:ok, config} -> config.viewer
      :error -> nil
    end
  end

  defp address(config, path, token) do
    query = if token, do: "?token=#{URI.encode_www_form(token)}", else: ""
    own = "#{config.scheme}://#{host(config.ip)}:#{config.port}"
    "#{if config.public, do: config.public.url, else: own}#{path}#{query}"
  end

  defp host({127, 0, 0, 1}), do: "localhost"
  defp host({0, 0, 0, 0, 0, 0, 0, 1}), do: "localhost"
  # Who listens everywhere wants others to come: the name by which this machine is known.
  defp host(any) when any in [{0, 0, 0, 0}, {0, 0, 0, 0, 0, 0, 0, 0}] do
    case :inet.gethostname() do
      {:ok, name} -> to_string(name)
    end
  end

  defp host(ip) when tuple_size(ip) == 8, do: "[#{:inet.ntoa(ip)}]"
  defp host(ip), do: "#{:inet.ntoa(ip)}"

  @doc false
  def endpoint(server) do
    server
    |> Supervisor.which_children()
    |> Enum.find_value(fn {id, pid, _, _} -> id == Listener && Listener.endpoint(pid) end)
  end
end
