defmodule Situ.Live.PublicAddressTest do
  # A server behind a reverse proxy: under a path, with TLS terminated at the proxy.
  use ExUnit.Case, async: true

  alias Situ.Live.{Endpoint, PublicAddress, Request, Response, Route}

  doctest PublicAddress

  defp config(public, more \\ []) do
    {:ok, public} = PublicAddress.parse(public)

    struct!(
      Endpoint,
      Keyword.merge(
        [
          ref: make_ref(),
          routes: Route.compile([{:get, "/data/at", fn _ -> Response.text("here") end}]),
          secret: "secret",
          ip: {127, 0, 0, 1},
          port: 4040,
          scheme: "http",
          hosts: ["localhost" | PublicAddress.allowed_hosts(public)],
          origins: PublicAddress.allowed_origins(public),
          public: public
        ],
        more
      )
    )
  end

  defp request(target, headers) do
    {:ok, request} = Request.new("GET", target, headers, peer: {{127, 0, 0, 1}, 1})
    request
  end

  test "accepts its path with or without the proxy's prefix, and rejects other paths" do
    config = config("https://lab.example.org/studio")
    host = %{"host" => "lab.example.org"}
    assert {:route, _, _} = Endpoint.admit_request(config, request("/studio/data/at", host))
    assert {:route, _, _} = Endpoint.admit_request(config, request("/data/at", host))

    assert {:respond, %{status: 404}} =
             Endpoint.admit_request(config, request("/other/data/at", host))

    assert {:respond, %{status: 421}} =
             Endpoint.admit_request(
               config,
               request("/studio/data/at", %{"host" => "evil.example"})
             )
  end

  test "its origin may connect, and another may not" do
    config = config("https://lab.example.org/studio")

    for {origin, status} <- [
          {"https://lab.example.org", :in},
          {"http://lab.example.org", 403},
          {"https://evil.example", 403}
        ] do
      headers = %{"host" => "lab.example.org", "origin" => origin, "upgrade" => "websocket"}

      case Endpoint.admit_request(config, request("/studio/live/websocket", headers)) do
        {:live_socket, _} -> assert status == :in
        {:respond, response} -> assert response.status == status
      end
    end
  end

  test "the token's cookie is limited to its path, and secure if the proxy terminates TLS" do
    config = config("https://lab.example.org/studio", token: "the-very-secret")
    target = "/studio/s/a%20b?token=the-very-secret&x=1"

    assert {:respond, %{status: 303, headers: headers}} =
             Endpoint.admit_request(config, request(target, %{"host" => "lab.example.org"}))

    headers = Map.new(headers)
    assert headers["location"] == "/studio/s/a%20b?x=1"
    assert headers["set-cookie"] =~ "; Path=/studio/; "
    assert headers["set-cookie"] =~ "; Secure"
  end

  test "rejects invalid addresses with an error" do
    for bad <- [
          "lab",
          "ftp://x",
          "https://",
          "https://x/?q",
          "https://u@x/",
          "https://x/a\"b",
          "https://x/..",
          7
        ] do
      assert {:error, %{code: :bad_public}} = PublicAddress.parse(bad)
    end
  end
end
