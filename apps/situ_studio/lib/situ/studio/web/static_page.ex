defmodule Situ.Studio.Web.StaticPage do
  @moduledoc false
  # Builds a page without a view on the server: a title, a body, and at most one script.
  alias Situ.Live.Response

  @csp "default-src 'self'; connect-src 'self' ws: wss:; media-src 'self' blob:; frame-ancestors 'none'"

  @html """
  <!doctype html>
  <html lang="en">
    <head>
      <meta charset="utf-8">
      <meta name="viewport" content="width=device-width, initial-scale=1">
      <base href="{base}">
      <title>{title} - Situ Studio</title>
      <link rel="icon" href="assets/favicon.svg">
      <link rel="stylesheet" href="assets/studio.css">
      <script src="assets/theme.js"></script>
      {script}
    </head>
    <body>
      <main class="message">
        {body}
      </main>
    </body>
  </html>
  """

  @doc "Builds a page from a `:title`, a `:body` and an optional `:script`; `:status` is 200 by default."
  @spec build_response(base :: String.t(), keyword()) :: Response.t()
  # The base is inserted unescaped: `Situ.Live.PublicAddress` checks that it has no characters that are special in HTML.
  def build_response(base, parts) do
    texts = [
      base: base,
      title: parts[:title],
      script: script_tag(parts[:script]),
      body: parts[:body]
    ]

    texts
    |> Enum.reduce(@html, fn {name, text}, html -> String.replace(html, "{#{name}}", text) end)
    |> Response.html(parts[:status] || 200)
    |> Response.put_header("content-security-policy", @csp)
  end

  defp script_tag(nil), do: ""
  defp script_tag(file), do: ~s(<script type="module" src="assets/#{file}"></script>)
end
