defmodule Situ.Infer.ServiceTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.Http
  doctest Situ.Infer.Service

  alias Situ.Infer.Service
  alias Situ.Infer.Test.ChatServer

  defp service(script, opts \\ [], header \\ :bearer) do
    server = ChatServer.start(script)
    {:ok, service} = Service.new(server.url, [backoff: 1] ++ opts, header)
    service
  end

  defp ask(service), do: Service.post(service, "/ask", [{"content-type", "text/plain"}], "what?")

  test "returns the complete response and sends the request unchanged" do
    service = service(fn _, _ -> ChatServer.answer("text/plain", "this") end)

    assert {:ok, "this"} = ask(service)
    assert_receive {:request, 1, %{first: "POST /v1/ask HTTP/1.1", body: "what?"}}
  end

  test "retries temporary failures, up to the limit" do
    script = fn
      _, 1 -> ChatServer.refuse(503, "busy")
      _, 2 -> [:reset]
      _, _ -> ChatServer.answer("text/plain", "there")
    end

    assert {:ok, "there"} = ask(service(script))
    assert {:error, %{code: :service_failed} = error} = ask(service(script, retries: 0))
    assert Exception.message(error) =~ "busy"
  end

  test "a refusal is final and includes the service's message" do
    service = service(fn _, _ -> ChatServer.refuse(404, "no such voice") end)
    assert {:error, %{code: :refused} = error} = ask(service)
    assert Exception.message(error) =~ "no such voice"
    refute_received {:request, 2, _}
  end

  test "understands the error formats of several services" do
    for body <- [
          ~s({"message": "full"}),
          ~s({"detail": [{"msg": "full"}]}),
          ~s({"error": {"message": "full"}}),
          "full"
        ] do
      head = "HTTP/1.1 400 No\r\nContent-Length: #{byte_size(body)}\r\n\r\n"
      assert {:error, %{what: what}} = ask(service(fn _, _ -> [head <> body] end))
      assert what =~ ~r/: full$/
    end
  end

  test "an endless response is cut off" do
    endless = "HTTP/1.1 200 OK\r\nContent-Type: a/b\r\nContent-Length: 100000000\r\n\r\n"
    many = List.duplicate(String.duplicate("x", 10_000), 20)

    assert {:error, %{code: :too_long}} =
             ask(service(fn _, _ -> [endless | many] end, most_bytes: 50_000))
  end

  test "a silent service, a cut connection and a missing service are errors" do
    silent = service(fn _, _ -> [{:wait, :never}] end, idle_timeout: 100, retries: 0)
    assert {:error, %{code: :timeout}} = ask(silent)

    half =
      service(fn _, _ -> ["HTTP/1.1 200 OK\r\nContent-Length: 10\r\n\r\nhalf"] end, retries: 0)

    assert {:error, %{code: :cut_off}} = ask(half)
    {:ok, nobody} = Service.new("http://127.0.0.1:1/", retries: 0)
    assert {:error, %{code: :no_connection}} = ask(nobody)
  end

  test "the key is sent in its header and never shown" do
    name = "SITU_TEST_SERVICE_KEY"
    System.put_env(name, "sesame-4711")
    on_exit(fn -> System.delete_env(name) end)
    loud = fn request, _ -> ChatServer.refuse(400, "bad key #{request.headers["x-key"]}") end
    service = service(loud, [key: name], "x-key")
    refute inspect(service) =~ "sesame"
    assert {:error, error} = ask(service)
    refute Exception.message(error) =~ "sesame"
    assert_receive {:request, 1, %{headers: %{"x-key" => "sesame-4711"}}}
    assert {:ok, _} = ask(service(fn _, _ -> ChatServer.answer("a/b", "") end, key: name))
    assert_receive {:request, 1, %{headers: %{"authorization" => "Bearer sesame-4711"}}}

    assert {:error, %{code: :no_key}} =
             ask(service(fn _, _ -> [] end, key: "SITU_TEST_NO_SUCH_KEY"))

    assert {:error, %{code: :not_private}} = Service.new("http://example.org", key: name)
    assert {:error, %{code: :bad_url}} = Service.new("ftp://example.org", [])
  end
end
