defmodule Situ.Live.EndpointTest do
  # Which requests are admitted, and with which role.
  use ExUnit.Case, async: true

  alias Situ.Live.{Endpoint, Request, Response, Route}

  @owner "the-token-of-owners"
  @viewer "the-token-of-viewers"

  defp config(fields \\ []) do
    struct!(
      %Endpoint{
        ref: make_ref(),
        routes:
          Route.compile([{:get, "/", fn request -> Response.text(inspect(request.role)) end}]),
        secret: String.duplicate("s", 32),
        ip: {0, 0, 0, 0},
        port: 4040,
        scheme: "http",
        token: @owner,
        viewer: @viewer,
        hosts: :any
      },
      fields
    )
  end

  defp request(query, headers \\ %{}) do
    {:ok, request} = Request.new("GET", "/" <> query, headers, host: "lab:4040")
    request
  end

  defp role(config, request) do
    case Endpoint.admit_request(config, request) do
      {:route, _, request} -> request.role
      {:respond, response} -> response.status
    end
  end

  # The cookie that replaces a token in the address.
  defp cookie(config, token) do
    {:respond, %{status: 303, headers: headers}} =
      Endpoint.admit_request(config, request("?token=" <> token))

    {_, text} = List.keyfind(headers, "set-cookie", 0)
    %{"cookie" => text |> String.split(";") |> hd()}
  end

  test "each token gives its role, once by the address and then by the cookie" do
    config = config()
    assert role(config, request("")) == 401
    assert role(config, request("", cookie(config, @owner))) == :owner
    assert role(config, request("", cookie(config, @viewer))) == :viewer
    bearer = &request("", %{"authorization" => "Bearer " <> &1})
    assert role(config, bearer.(@viewer)) == :viewer
    assert role(config, bearer.(@owner)) == :owner
    assert role(config, bearer.("the-token-of-nobody")) == 401
  end

  test "a viewer becomes an owner with the owner's token, and an owner stays one" do
    config = config()
    viewer = cookie(config, @viewer)
    assert role(config, request("?token=" <> @owner, viewer)) == 303
    assert role(config, request("?token=wrong-wrong-wrong", viewer)) == 401
    assert role(config, request("?token=" <> @viewer, cookie(config, @owner))) == :owner
  end

  test "a cookie expires with its token and is worthless if viewers are disabled" do
    viewer = cookie(config(), @viewer)
    owner = cookie(config(), @owner)
    assert role(config(viewer: nil), request("", viewer)) == 401
    assert role(config(viewer: "another-token"), request("", viewer)) == 401
    assert role(config(viewer: "another-token"), request("", owner)) == :owner
    assert role(config(token: "another-token"), request("", owner)) == 401
    assert role(config(token: nil, viewer: nil), request("")) == :owner
  end

  test "an inspected configuration shows no secrets" do
    shown = inspect(config(), limit: :infinity, printable_limit: :infinity)
    for secret <- [@owner, @viewer, String.duplicate("s", 32)], do: refute(shown =~ secret)
  end
end
