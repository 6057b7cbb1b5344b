defmodule Situ.Live.StalledTest do
  # Clients that begin a request and stop. The waits are real because the server's own limits are tested.
  use ExUnit.Case, async: true
  alias Situ.Live.{Raw, Response}

  @moduletag timeout: 60_000

  setup_all do
    handler = fn request -> Response.text(request.body) end
    {:ok, server} = Situ.Live.start_link(port: 0, body_ms: 300, routes: [{:any, "/", handler}])
    {:ok, port: Situ.Live.port(server)}
  end

  test "300 requests without an end of the head block nobody and are closed after 15 s", %{
    port: port
  } do
    stalled =
      for _ <- 1..300 do
        socket = Raw.connect(port)
        :ok = :gen_tcp.send(socket, "GET / HTTP/1.1\r\nhost: local")
        socket
      end

    assert {200, _, ""} = Raw.get(port, "/")
    for socket <- stalled, do: assert({:error, :closed} = :gen_tcp.recv(socket, 0, 60_000))
  end

  test "a body that trickles in is rejected after its time limit", %{
    port: port
  } do
    socket = Raw.connect(port)
    :ok = :gen_tcp.send(socket, Raw.head("POST", "/", port, [{"content-length", "1000"}]))
    assert {408, %{"connection" => "close"}, _} = trickle(socket)
  end

  defp trickle(socket) do
    :gen_tcp.send(socket, "x")

    case :gen_tcp.recv(socket, 0, 50) do
      {:error, :timeout} ->
        trickle(socket)

      {:ok, "HTTP/1.1 408" <> _ = head} ->
        {408, %{"connection" => if(head =~ "connection: close", do: "close")}, ""}
    end
  end
end
