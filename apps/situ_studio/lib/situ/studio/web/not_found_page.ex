defmodule Situ.Studio.Web.NotFoundPage do
  @moduledoc false
  # An address of a studio that has nothing: a page with the way back for people, a line for programs.
  alias Situ.Live.{Request, Response}

  @html """
  <!doctype html>
  <html lang="en">
    <head>
      <meta charset="utf-8">
      <meta name="viewport" content="width=device-width, initial-scale=1">
      <base href="{base}">
      <title>Not found - Situ Studio</title>
      <link rel="icon" href="assets/favicon.svg">
      <link rel="stylesheet" href="assets/studio.css">
      <script src="assets/theme.js"></script>
    </head>
    <body>
      <main class="message">
        <div role="alert">
          <h1>There is no page at this address</h1>
          <p>The link may be incomplete, or of another version of the studio.</p>
        </div>
        <p><a class="btn" href=".">All recordings</a></p>
      </main>
    </body>
  </html>
  """

  @csp "default-src 'self'; frame-ancestors 'none'"

  @spec call(Request.t(), base :: String.t()) :: Response.t()
  def call(%Request{} = request, base) do
    if String.contains?(Request.header(request, "accept") || "", "text/html") do
      @html
      |> String.replace("{base}", base)
      |> Response.html(404)
      |> Response.put_header("content-security-policy", @csp)
    else
      Response.error(404, "not found")
    end
  end
end
