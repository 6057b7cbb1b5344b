# A Phoenix application in one file: a login, the studio at /situ, and a page with a live panel at /lab.
#
#     MIX_ENV=test mix run examples/lab.exs
#
# Then open http://localhost:4000/situ; any name logs in.
defmodule Lab.Pipeline do
  use Situ.Pipeline

  @impl true
  def build(p, _opts) do
    p
    |> Situ.sequence(0, &(&1 + 1), every: Situ.Time.ms(20), name: "Count")
    |> Situ.map(&:math.sin(&1 / 30), name: "Level")
    |> Situ.map(&picture/1, name: "Picture")
  end

  defp picture(level) do
    gray = round(127 + 120 * level)
    Situ.Image.new!(width: 64, height: 48, format: :gray8, data: :binary.copy(<<gray>>, 64 * 48))
  end
end

defmodule Lab.Page do
  use Phoenix.LiveView
  import Situ.Phoenix.Components

  def mount(_params, _session, socket),
    do:
      {:ok,
       socket |> assign(count: 0) |> Situ.Phoenix.subscribe({Lab.Pipeline, "Count"}, every: 500)}

  def handle_info({:situ, "Count", %Situ.Message{data: count}}, socket),
    do: {:noreply, assign(socket, count: count)}

  def handle_info({:situ, "Count", _ended_or_error}, socket), do: {:noreply, socket}

  def render(assigns) do
    ~H"""
    <p>Count: <b id="count"><%= @count %></b></p>
    <.situ_panel stream={{Lab.Pipeline, "Level"}} />
    <.situ_panel stream={{Lab.Pipeline, "Picture"}} every={200} />
    <p><a href="/situ">The studio</a></p>
    """
  end
end

defmodule Lab.Layout do
  use Phoenix.Component

  # The stock scripts of the two packages; `mix phx.new` bundles them instead.
  def root(assigns) do
    ~H"""
    <!DOCTYPE html>
    <html lang="en">
      <head>
        <title>Lab</title>
        <link rel="icon" href="data:," />
        <meta name="csrf-token" content={Plug.CSRFProtection.get_csrf_token()} />
        <script src="/phoenix/phoenix.min.js"></script>
        <script src="/live_view/phoenix_live_view.min.js"></script>
        <script>
          const token = document.querySelector("meta[name=csrf-token]").content;
          const params = { _csrf_token: token };
          new LiveView.LiveSocket("/live", Phoenix.Socket, { params }).connect();
        </script>
      </head>
      <body><%= @inner_content %></body>
    </html>
    """
  end
end

defmodule Lab.Login do
  use Phoenix.Controller, formats: [:html]

  def new(conn, _params) do
    html(
      conn,
      ~s(<form method="get" action="/welcome"><input name="name"><button>Log in</button></form>)
    )
  end

  def create(conn, %{"name" => name}),
    do:
      conn |> configure_session(renew: true) |> put_session(:user, name) |> redirect(to: "/situ")
end

defmodule Lab.Router do
  use Phoenix.Router
  import Plug.Conn
  import Phoenix.Controller
  import Phoenix.LiveView.Router
  import Situ.Phoenix.Router

  pipeline :browser do
    plug(:accepts, ["html"])
    plug(:fetch_session)
    plug(:put_root_layout, html: {Lab.Layout, :root})
    plug(:protect_from_forgery)
    plug(:put_secure_browser_headers)
  end

  defp require_login(conn, _opts) do
    if get_session(conn, :user),
      do: conn,
      else: conn |> Phoenix.Controller.redirect(to: "/login") |> halt()
  end

  scope "/" do
    pipe_through(:browser)
    get("/login", Lab.Login, :new)
    get("/welcome", Lab.Login, :create)
  end

  scope "/" do
    pipe_through([:browser, :require_login])
    live("/lab", Lab.Page)
    situ_studio("/situ", recordings: "recordings", pipelines: [Lab.Pipeline])
  end
end

defmodule Lab.Endpoint do
  use Phoenix.Endpoint, otp_app: :situ_phoenix
  @session [store: :cookie, key: "_lab", signing_salt: "lab's cookies", same_site: "Lax"]
  socket("/live", Phoenix.LiveView.Socket, websocket: [connect_info: [session: @session]])
  plug(Plug.Static, at: "/phoenix", from: {:phoenix, "priv/static"})
  plug(Plug.Static, at: "/live_view", from: {:phoenix_live_view, "priv/static"})
  plug(Plug.Parsers, parsers: [:urlencoded])
  plug(Plug.Session, @session)
  plug(Lab.Router)
end

defmodule Lab.Errors do
  def render(template, _assigns), do: Phoenix.Controller.status_message_from_template(template)
end

Application.put_env(:situ_phoenix, Lab.Endpoint,
  adapter: Bandit.PhoenixAdapter,
  http: [ip: {127, 0, 0, 1}, port: String.to_integer(System.get_env("PORT", "4000"))],
  server: true,
  url: [host: "localhost"],
  render_errors: [formats: [html: Lab.Errors]],
  secret_key_base: Base.encode64(:crypto.strong_rand_bytes(48)),
  live_view: [signing_salt: "lab's live views"]
)

{:ok, _} =
  Supervisor.start_link([{Lab.Pipeline, pipeline: [name: Lab.Pipeline]}, Lab.Endpoint],
    strategy: :one_for_one
  )

Process.sleep(:infinity)
