defmodule Situ.Live.Endpoint do
  @moduledoc false
  # The configuration of one server, in a persistent term because each request reads it, and the checks that every
  # request must pass: host, token, origin, route. The checks are pure: they take a request and return what to do.
  # See docs/adr/0073-every-request-passes-one-gate.md.
  alias Situ.Live.{
    InitialRender,
    TokenRateLimit,
    PublicAddress,
    Request,
    Response,
    Route,
    Static,
    Token,
    TokenPage
  }

  @cookie_age_s 30 * 86_400

  # The log shows the start arguments of a server that fails, so secrets must not be inspected.
  @derive {Inspect, except: [:secret, :token, :viewer]}
  @enforce_keys [:ref, :routes, :secret, :ip, :port, :scheme]
  defstruct [
    :ref,
    :routes,
    :secret,
    :ip,
    :port,
    :scheme,
    :token,
    :viewer,
    :hosts,
    :public,
    layout: nil,
    origins: [],
    headers: [],
    images: [],
    max_body: 1_000_000,
    body_ms: 30_000,
    max_frame: 1_000_000,
    max_sockets: 500,
    live_path: ["live", "websocket"],
    flow: %{}
  ]

  @type t :: %__MODULE__{}

  @spec fetch_config(reference()) :: {:ok, t()} | :error
  def fetch_config(ref) do
    case :persistent_term.get({__MODULE__, ref}, nil) do
      nil -> :error
      config -> {:ok, config}
    end
  end

  @spec put_config(t()) :: :ok
  def put_config(%__MODULE__{ref: ref} = config),
    do: :persistent_term.put({__MODULE__, ref}, config)

  @spec erase_config(reference()) :: boolean()
  def erase_config(ref), do: :persistent_term.erase({__MODULE__, ref})

  @type route :: {:live_socket, Request.t()} | {:route, Route.t(), Request.t()}

  @doc "Checks a request and returns its route, or the response that rejects it."
  @spec admit_request(t(), Request.t()) :: route() | {:respond, Response.t()}
  def admit_request(config, %{segments: segments} = request) do
    request = %{request | segments: PublicAddress.strip_base(config.public, segments)}

    with :ok <- check_host(config, request),
         {:ok, role} <- check_token(config, request),
         :ok <- check_origin(config, request) do
      find_route(config, %{request | role: role})
    end
  end

  defp find_route(%{live_path: path}, %Request{segments: path} = request),
    do: {:live_socket, request}

  defp find_route(config, request) do
    case Route.match_request(config.routes, request) do
      {:ok, route, params} ->
        {:route, route, %{request | params: params}}

      {:error, :not_found} ->
        {:respond, Response.error(404, "not found")}

      {:error, {:method, methods}} ->
        allow = Enum.join(Enum.uniq(methods), ", ")

        {:respond,
         405 |> Response.error("method not allowed") |> Response.put_header("allow", allow)}
    end
  end

  # Rejects names that another site points at this machine (DNS rebinding).
  defp check_host(%{hosts: :any}, _), do: :ok

  defp check_host(config, request) do
    if host_name(request.host) in config.hosts,
      do: :ok,
      else: {:respond, Response.error(421, "this server does not accept that host name")}
  end

  @doc false
  # Returns the name without the port, or "" if `host` is not a host name with an optional port.
  def host_name(host) do
    case Regex.run(~r/\A(?:\[([0-9a-f:.]+)\]|([a-z0-9._-]+))(?::\d{1,5})?\z/i, host) do
      [_, "", name] -> String.downcase(name)
      [_, address] -> String.downcase(address)
      nil -> ""
    end
  end

  # The web server that passes requests to a server without a port may have set the role.
  defp check_token(%{token: nil}, request), do: {:ok, request.role}

  # A viewer may bring an owner's token, so only an owner's cookie takes precedence over a token in the request.
  defp check_token(config, request) do
    case {verify_cookie(config, request), find_sent_token(request)} do
      {{:ok, :owner}, _} -> {:ok, :owner}
      {{:ok, :viewer}, nil} -> {:ok, :viewer}
      {_, sent} -> check_sent_token(config, request, sent)
    end
  end

  defp check_sent_token(_config, request, nil),
    do: {:respond, TokenPage.build_response(request, false)}

  # After too many wrong guesses from an address, its tokens are not even compared.
  defp check_sent_token(config, %{peer: {address, _}} = request, {source, token}) do
    role =
      cond do
        TokenRateLimit.too_many?(config.ref, address) -> :guessing
        same_token?(token, config.token) -> :owner
        config.viewer != nil and same_token?(token, config.viewer) -> :viewer
        true -> nil
      end

    case role do
      :guessing ->
        {:respond, too_many_guesses_response()}

      role when role in [:owner, :viewer] ->
        if source == :query,
          do: {:respond, redirect_with_cookie(config, request, role)},
          else: {:ok, role}

      nil ->
        TokenRateLimit.count_wrong_token(config.ref, address)
        {:respond, TokenPage.build_response(request, true)}
    end
  end

  defp find_sent_token(request) do
    case {Request.get_header(request, "authorization"), request.query["token"]} do
      {"Bearer " <> token, _} -> {:bearer, token}
      {_, token} when is_binary(token) -> {:query, token}
      _ -> nil
    end
  end

  defp too_many_guesses_response do
    429
    |> Response.error("too many invalid tokens came from this address; wait a minute")
    |> Response.put_header("retry-after", "60")
  end

  defp verify_cookie(config, request) do
    cookie = Request.get_cookie(request, cookie_name(config))

    Enum.find_value([:owner, :viewer], :error, fn role ->
      with key when is_binary(key) <- cookie_key(config, role),
           {:ok, _} <- Token.verify(key, "cookie", cookie, @cookie_age_s),
           do: {:ok, role},
           else: (_ -> nil)
    end)
  end

  # The key contains the token, so a cookie expires with its token and identifies the role.
  defp cookie_key(config, :owner), do: config.secret <> config.token
  defp cookie_key(%{viewer: nil}, :viewer), do: nil
  defp cookie_key(config, :viewer), do: config.secret <> "viewer" <> config.viewer

  # Cookies are shared between ports, and several servers may run on a machine.
  defp cookie_name(config), do: "situ_#{config.port}"

  defp same_token?(sent, token) when is_binary(sent) and byte_size(sent) == byte_size(token),
    do: :crypto.hash_equals(sent, token)

  defp same_token?(_, _), do: false

  # Moves the token from the address bar into a cookie.
  defp redirect_with_cookie(config, request, role) do
    rest = request.query |> Map.delete("token") |> Situ.Live.Query.encode()

    path =
      PublicAddress.base_path(config.public) <>
        "/" <>
        Enum.map_join(
          request.segments,
          "/",
          &URI.encode(&1, fn char -> URI.char_unreserved?(char) end)
        )

    cookie = Token.sign(cookie_key(config, role), "cookie", %{})
    public = config.public
    secure = if config.scheme == "https" or (public && public.secure?), do: "; Secure", else: ""

    Response.redirect(if(rest == "", do: path, else: path <> "?" <> rest), 303)
    |> Response.put_header(
      "set-cookie",
      "#{cookie_name(config)}=#{cookie}; Path=#{PublicAddress.base_path(public)}/; HttpOnly; SameSite=Strict; " <>
        "Max-Age=#{@cookie_age_s}#{secure}"
    )
  end

  # Browsers always send the origin of a WebSocket or a POST; other programs do not.
  defp check_origin(config, request) do
    origin = Request.get_header(request, "origin")
    origin_needed? = request.method not in ["GET", "HEAD"] or websocket_upgrade?(request)

    if not origin_needed? or origin in [nil | config.origins] or
         own_origin?(origin, config, request),
       do: :ok,
       else: {:respond, Response.error(403, "requests from other sites are not allowed")}
  end

  # For the host name of the proxy, only the proxy's own origin is allowed, including its scheme.
  defp own_origin?(origin, config, request) do
    host_name(request.host) not in PublicAddress.allowed_hosts(config.public) and
      origin == config.scheme <> "://" <> request.host
  end

  @doc false
  def websocket_upgrade?(request) do
    request |> Request.get_header("upgrade") |> to_string() |> String.downcase() == "websocket"
  end

  @doc "Returns the maximum body size of a route in bytes."
  @spec max_body(t(), route()) :: non_neg_integer()
  def max_body(config, {:route, %Route{kind: :http, opts: opts}, _}),
    do: opts[:max_body] || config.max_body

  def max_body(_, _), do: 0

  @doc """
  Runs the handler of an admitted request. Returns a `Situ.Live.Response`, or `{:upgrade, module, arg, opts, request}`
  for WebSockets. A handler of an application may return any term.
  """
  @spec run_route(t(), route()) :: term()
  def run_route(config, {:live_socket, request}) do
    upgrade_connection(Situ.Live.Channel, config, [max_frame: config.max_frame], request)
  end

  def run_route(_config, {:route, %Route{kind: :socket} = route, request}) do
    upgrade_connection(route.target, route.arg, route.opts, request)
  end

  def run_route(_config, {:route, %Route{kind: :static} = route, request}) do
    Static.serve_file(request, route.target, request.params["path"], route.opts)
  end

  def run_route(_config, {:route, %Route{kind: :http, target: {module, arg}}, request}),
    do: module.call(request, arg)

  def run_route(_config, {:route, %Route{kind: :http, target: fun}, request}), do: fun.(request)

  def run_route(config, {:route, %Route{kind: :live} = route, request}),
    do: InitialRender.render_page(config, route, request)

  defp upgrade_connection(handler, arg, opts, request) do
    if websocket_upgrade?(request) do
      {:upgrade, handler, arg, opts, request}
    else
      426
      |> Response.error("this address accepts only WebSocket connections")
      |> Response.put_header("upgrade", "websocket")
    end
  end
end
