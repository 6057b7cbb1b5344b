defmodule Situ.Studio.Web.NotFoundPageTest do
  use ExUnit.Case, async: true

  alias Situ.Live.Request
  alias Situ.Studio.Web.NotFoundPage

  test "people get a page with a link to the list, below the studio's path" do
    request = %Request{headers: %{"accept" => "text/html,application/xhtml+xml,*/*;q=0.8"}}
    response = NotFoundPage.call(request, "/lab/studio/")
    body = IO.iodata_to_binary(response.body)
    assert response.status == 404
    assert body =~ ~s(<base href="/lab/studio/">)
    assert body =~ ~s(href=".">All recordings</a>)
  end

  test "programs get one line" do
    response = NotFoundPage.call(%Request{headers: %{"accept" => "*/*"}}, "/")
    assert {response.status, IO.iodata_to_binary(response.body)} == {404, "404 not found\n"}
  end
end
