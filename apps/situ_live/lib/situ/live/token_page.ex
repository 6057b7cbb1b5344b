defmodule Situ.Live.TokenPage do
  @moduledoc false
  # The page that asks for the server's token. Nothing else of the server can be loaded without the token, so the page
  # has no style sheet and no script.
  alias Situ.Live.{Html, Request, Response}

  @csp "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'"

  @doc """
  Builds the response to a request without a valid token. Browsers get a form, and other programs one line of text.
  With `wrong?`, the request had an invalid token.
  """
  @spec build_response(Request.t(), wrong? :: boolean()) :: Response.t()
  def build_response(request, wrong?) do
    request
    |> build_body(wrong?)
    |> Response.put_header("www-authenticate", "Bearer")
    |> Response.put_header("cache-control", "no-store")
  end

  defp build_body(request, wrong?) do
    if request.method == "GET" and accepts_html?(request) do
      request
      |> render_page(wrong?)
      |> Response.html(401)
      |> Response.put_header("content-security-policy", @csp)
    else
      Response.error(401, "open the address that the server printed, which contains the token")
    end
  end

  defp accepts_html?(request) do
    request |> Request.get_header("accept") |> to_string() |> String.contains?("text/html")
  end

  # The form opens the same address with the token.
  defp render_page(request, wrong?) do
    """
    <!doctype html>
    <html lang="en">
      <head>
        <meta charset="utf-8">
        <meta name="viewport" content="width=device-width, initial-scale=1">
        <meta name="color-scheme" content="light dark">
        <title>Token required</title>
        <style>
          body { font: 15px/1.5 system-ui, sans-serif; max-width: 30em; margin: 15vh auto 0; padding: 0 20px }
          h1 { font-size: 20px }
          form { display: flex; gap: 8px }
          input, button { font: inherit; padding: 4px 10px }
          input { flex: 1; min-width: 0 }
        </style>
      </head>
      <body>
        <h1>Token required</h1>
        <p>#{if wrong?, do: "This token is not valid.", else: "This page needs a token."} The server printed its
          address with the token when it started. Open that address, or enter the token.</p>
        <form method="get">
          #{hidden_fields(request.query)}<input name="token" type="password" aria-label="Token" autofocus required>
          <button>Open</button>
        </form>
      </body>
    </html>
    """
  end

  # A link to a view of a recording keeps its view.
  defp hidden_fields(query) do
    for {name, value} <- Map.delete(query, "token"),
        is_binary(value),
        do: ~s(<input type="hidden" name="#{Html.escape(name)}" value="#{Html.escape(value)}">)
  end
end
