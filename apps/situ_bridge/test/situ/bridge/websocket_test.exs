defmodule Situ.Bridge.WebSocketTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.{ServerSentEvents, WebSocket}
  alias Situ.Bridge.WebSocket.Handshake

  @moduletag :capture_log

  for {module, formats} <- [
        {WebSocket, [:json, :message_pack, :situ]},
        {ServerSentEvents, [:json]}
      ],
      format <- formats do
    test "#{inspect(module)} carries #{format} and its times" do
      me = self()
      values = for i <- 1..300, do: {i * 1_000_003, %{"n" => i, "text" => "a\nb"}}
      opts = [wait_for: 1, listening: me, format: unquote(format), high_water_mark: 10_000]

      {:ok, server} =
        Situ.Pipeline.start_link(fn p ->
          p |> Situ.from_enumerable(values) |> unquote(module).serve(0, opts)
        end)

      port = receive(do: ({:listening, port} -> port))

      {:ok, client} =
        Situ.Pipeline.start_link(fn p ->
          p
          |> unquote(module).connect("127.0.0.1", port, format: unquote(format))
          |> Situ.map(fn value, message -> {message.originating_time, value} end)
          |> Situ.each(&send(me, {:got, &1}))
        end)

      got =
        for _ <- values,
            do: receive(do: ({:got, got} -> got), after: (30_000 -> flunk("no more")))

      assert got == values
      Situ.Pipeline.stop(client)
      Situ.Pipeline.stop(server)
    end
  end

  defp ask(headers, opts) do
    base =
      "GET /x HTTP/1.1\r\nHost: a\r\nUpgrade: websocket\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"

    Handshake.admit_client(base <> headers <> "\r\nrest", opts)
  end

  test "accepts a request by RFC 6455, and chooses its protocol" do
    assert {:ok, answer, "b", "/x", "rest"} =
             ask("Sec-WebSocket-Protocol: c, a ,b\r\n", protocols: ["b", "a"])

    answer = IO.iodata_to_binary(answer)
    assert answer =~ "Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n"
    assert answer =~ "Sec-WebSocket-Protocol: b\r\n"
    assert {:refuse, _} = ask("Sec-WebSocket-Protocol: c\r\n", protocols: ["b"])
  end

  test "refuses pages of other sites" do
    assert {:refuse, answer} = ask("Origin: https://evil.example\r\n", [])
    assert IO.iodata_to_binary(answer) =~ "403"
    assert {:ok, _, _, _, _} = ask("Origin: http://localhost:3000\r\n", [])

    assert {:ok, _, _, _, _} =
             ask("Origin: https://app.example\r\n", origins: ["https://app.example"])

    assert {:refuse, _} = ask("Origin: http://[\r\n", [])
  end

  test "refuses invalid requests, and limits the size of unfinished ones" do
    assert Handshake.admit_client("GET / HT", []) == :more
    assert {:refuse, _} = Handshake.admit_client("POST / HTTP/1.1\r\n\r\n", [])
    assert {:refuse, _} = Handshake.admit_client(<<255, 0, "\r\n\r\n">>, [])
    assert {:refuse, _} = Handshake.admit_client(:binary.copy("a", 20_000), [])
  end
end
