defmodule Situ.Studio.Web.NotFoundPage do
  @moduledoc false
  # Handles every address that the studio does not have: browsers get a page with a link back, programs a single line.
  alias Situ.Live.{Request, Response}
  alias Situ.Studio.Web.StaticPage

  @body """
  <div role="alert">
    <h1>Page not found</h1>
    <p>The link may be incomplete, or it may belong to another version of the studio.</p>
  </div>
  <p><a class="btn" href=".">All recordings</a></p>
  """

  @spec call(Request.t(), base :: String.t()) :: Response.t()
  def call(%Request{} = request, base) do
    if String.contains?(Request.get_header(request, "accept") || "", "text/html"),
      do: StaticPage.build_response(base, title: "Not found", body: @body, status: 404),
      else: Response.error(404, "not found")
  end
end
