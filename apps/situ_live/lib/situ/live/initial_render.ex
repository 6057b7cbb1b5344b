defmodule Situ.Live.InitialRender do
  @moduledoc false
  # The first HTML of a page: the view is rendered once without a browser, in the layout, with its signed session.
  alias Situ.Live.{Html, ViewLifecycle, PublicAddress, Request, Response, Route, Socket, Token}

  @csp "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; " <>
         "media-src 'self' blob:; worker-src 'self' blob:; connect-src 'self'; object-src 'none'; base-uri 'self'; " <>
         "frame-ancestors 'self'; form-action 'self'"

  @spec render_page(Situ.Live.Endpoint.t(), Route.t(), Request.t()) :: Response.t()
  def render_page(config, route, request) do
    session = resolve_session(route.opts[:session], request)
    id = "phx-" <> Base.url_encode64(:crypto.strong_rand_bytes(9), padding: false)
    params = Map.merge(request.query, request.params)
    uri = request_uri(config, request)

    socket =
      ViewLifecycle.mount_view(route, params, session, uri, %Socket{id: id, endpoint: config.ref})

    case socket.navigation do
      nil ->
        build_response(config, route, socket, session)

      {_, %{"to" => "/" <> _ = to}} ->
        Response.redirect(PublicAddress.base_path(config.public) <> to)

      {_, %{"to" => to}} ->
        Response.redirect(to)
    end
  end

  defp build_response(config, route, socket, session) do
    claims = %{
      "id" => socket.id,
      "view" => ViewLifecycle.session_scope(route),
      "session" => session
    }

    token = Token.sign(config.secret, "session", claims)

    content = [
      ~s(<div id="),
      socket.id,
      ~s(" data-phx-main data-phx-session="),
      token,
      ~s(" data-phx-static="">),
      socket |> ViewLifecycle.render_view(:all) |> Html.to_iodata(),
      "</div>"
    ]

    layout = route.opts[:layout] || config.layout || (&__MODULE__.default_layout/1)

    assigns =
      socket.assigns
      |> Map.merge(%{__changed__: nil, inner_content: {:safe, content}})
      |> Map.put_new(:page_title, nil)

    html = ["<!doctype html>\n", assigns |> layout.() |> Html.escape() |> Html.to_iodata()]

    html
    |> Response.html()
    |> Response.put_header("cache-control", "no-store")
    |> Response.put_header("content-security-policy", content_policy(config.images))
  end

  defp content_policy([]), do: @csp

  defp content_policy(images),
    do: String.replace(@csp, "blob: data:;", "blob: data: #{Enum.join(images, " ")};")

  use Situ.Live.Component

  @doc "Renders the default layout, which loads `/app.js`."
  def default_layout(assigns) do
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

  defp resolve_session(nil, _), do: %{}
  defp resolve_session(fun, request) when is_function(fun, 1), do: fun.(request)
  defp resolve_session(%{} = session, _), do: session

  defp request_uri(config, request) do
    query = if request.query_string == "", do: "", else: "?" <> request.query_string
    "#{config.scheme}://#{request.host}#{request.path}#{query}"
  end
end
