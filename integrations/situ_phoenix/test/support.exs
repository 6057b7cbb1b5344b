defmodule Situ.Phoenix.TestApp do
  # A Phoenix application like one of `mix phx.new`, with a login that any name passes.
  defmodule Login do
    use Phoenix.Controller, formats: [:html]

    def create(conn, %{"name" => name}),
      do: conn |> put_session(:user, name) |> text("welcome " <> name)

    def require_user(conn, _opts) do
      if get_session(conn, :user),
        do: conn,
        else: conn |> redirect(to: "/login/ada") |> halt()
    end

    def guest?(conn), do: get_session(conn, :user) == "guest"
    def studio_options, do: [recordings: Application.fetch_env!(:situ_phoenix, :recordings)]
  end

  defmodule Router do
    use Phoenix.Router
    import Plug.Conn
    import Login, only: [require_user: 2]
    import Situ.Phoenix.Router

    pipeline :browser do
      plug(:accepts, ["html"])
      plug(:fetch_session)
      plug(:protect_from_forgery)
      plug(:put_secure_browser_headers)
    end

    scope "/" do
      pipe_through(:browser)
      get("/login/:name", Login, :create)
    end

    scope "/lab" do
      pipe_through([:browser, :require_user])
      situ_studio("/situ", {Login, :studio_options, []})
      situ_studio("/guests", viewer?: {Login, :guest?}, read_only: true)
    end
  end

  for {module, adapter} <- [
        {Bandit, Bandit.PhoenixAdapter},
        {Cowboy, Phoenix.Endpoint.Cowboy2Adapter}
      ] do
    defmodule Module.concat(__MODULE__, module) do
      use Phoenix.Endpoint, otp_app: :situ_phoenix
      @options [store: :cookie, key: "_lab", signing_salt: "salt", same_site: "Lax"]
      plug(Plug.Parsers, parsers: [:urlencoded, :json], pass: ["*/*"], json_decoder: Jason)
      plug(Plug.Head)
      plug(Plug.Session, @options)
      plug(Router)

      def options(port) do
        [
          adapter: unquote(adapter),
          http: [ip: {127, 0, 0, 1}, port: port],
          server: true,
          url: [host: "lab.example.org", scheme: "https", port: 443],
          secret_key_base: String.duplicate("s", 64),
          live_view: [signing_salt: "salt of the tests"],
          render_errors: [formats: [html: __MODULE__]]
        ]
      end

      def render(_template, _assigns), do: "error"
    end
  end

  # Starts the endpoint on a free port and returns the port.
  def start(endpoint) do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    Application.put_env(:situ_phoenix, endpoint, endpoint.options(port))
    {:ok, _} = ExUnit.Callbacks.start_supervised(endpoint)
    port
  end
end
