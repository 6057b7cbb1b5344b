defmodule Situ.Live.Dead do
  @moduledoc false
  # The first HTML of a page: the view is rendered once without a browser, in the layout, with its signed session.
  alias Situ.Live.{Html, Page, Public, Request, Response, Route, Socket, Token}

  @csp "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; " <>
         "media-src 'self' blob:; worker-src 'self' blob:; connect-src 'self'; object-src 'none'; base-uri 'self'; " <>
         "frame-ancestors 'self'; form-action 'self'"

  @spec render(Situ.Live.Endpoint.t(), Route.t(), Request.t()) :: Response.t()
  def render(config, route, request) do
    session = session(route.opts[:session], request)
    id = "phx-" <> Base.url_encode64(:crypto.strong_rand_bytes(9), padding: false)
    params = Map.merge(request.query, request.params)
    uri = uri(config, request)
    socket = Page.mount(route, params, session, uri, %Socket{id: id, endpoint: config.ref})

    case socket.navigation do
      nil -> page(config, route, socket, session)
      {_, %{"to" => "/" <> _ = to}} -> Response.redirect(Public.base(config.public) <> to)
      {_, %{"to" => to}} -> Response.redirect(to)
    end
  end

  defp page(config, route, socket, session) do
    claims = %{"id" => socket.id, "view" => Page.name(route), "session" => session}
    token = Token.sign(config.secret, "session", claims)

    content = [
      ~s(<div id="),
      socket.id,
      ~s(" data-phx-main data-phx-session="),
      token,
      ~s(" data-phx-static="">),
      socket |> Page.render(:all) |> Html.to_iodata(),
      "</div>"
    ]

    layout = route.opts[:layout] || config.layout || (&__MODULE__.layout/1)

    assigns =
      socket.assigns
      |> Map.merge(%{__changed__: nil, inner_content: {:safe, content}})
      |> Map.put_new(:page_title, nil)

    html = ["<!doctype html>\n", assigns |> layout.() |> Html.escape() |> Html.to_iodata()]

    html
    |> Response.html()
    |> Response.put_header("cache-control", "no-store")
    |> Response.put_header("content-security-policy", policy(config.images))
  end

  defp policy([]), do: @csp

  defp policy(images),
    do: String.replace(@csp, "blob: data:;", "blob: data: #{Enum.join(images, " ")};")

  use Situ.Live.Component

  @doc "Renders the default layout, which loads `/app.js`."
  def layout(assigns) do
    ~H"""
    <html lang="en">
      <head>
        <meta charset="utf-8">
        <meta name="viewport" content="width=device-width, initial-scale=1">
        <title>{@page_title}</title>
        <link rel="icon" href="data:,">
        <script defer src="/app.js"></script>
      </head>
      <body>{@inner_content}</body>
    </html>
    """
  end

  defp session(nil, _), do: %{}
  defp session(fun, request) when is_function(fun, 1), do: fun.(request)
  defp session(%{} = session, _), do: session

  defp uri(config, request) do
    query = if request.query_string == "", do: "", else: "?" <> request.query_string
    "#{config.scheme}://#{request.host}#{request.path}#{query}"
  end
end
