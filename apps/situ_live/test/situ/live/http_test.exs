defmodule Situ.Live.HttpTest do
  # Tests the HTTP server from outside, through raw sockets.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  alias Situ.Live.{Demo, Raw, Response}

  @moduletag :tmp_dir

  defp start(routes, opts \\ []) do
    server = start_supervised!({Situ.Live, [port: 0, routes: routes] ++ opts}, id: make_ref())
    {server, Situ.Live.port(server)}
  end

  defp heavy(n), do: Response.text(Integer.to_string(n))
  defp echo(request), do: Response.text([request.method, " ", request.body])

  describe "requests" do
    test "handles routes, methods, bodies, HEAD and keep-alive" do
      {_, port} =
        start([{:get, "/a/:x", &Response.text(&1.params["x"])}, {:post, "/echo", &echo/1}])

      assert {200, headers, "b c"} = Raw.get(port, "/a/b%20c")
      assert headers["x-content-type-options"] == "nosniff"
      assert {200, _, "POST hello"} = Raw.post(port, "/echo", "hello")
      assert {404, _, _} = Raw.get(port, "/b")
      assert {405, %{"allow" => "GET"}, _} = Raw.post(port, "/a/b", "")

      socket = Raw.connect(port)

      for i <- 1..3 do
        :ok = :gen_tcp.send(socket, Raw.head("GET", "/a/#{i}", port, []))
        assert {200, _, body} = Raw.response(socket)
        assert body == "#{i}"
      end

      :ok = :gen_tcp.send(socket, Raw.head("HEAD", "/a/long", port, []))
      assert {200, %{"content-length" => "4"}, ""} = Raw.response(socket, "HEAD")
      :ok = :gen_tcp.send(socket, Raw.head("GET", "/a/last", port, [{"connection", "close"}]))
      assert {200, _, "last"} = Raw.response(socket)
      assert {:error, :closed} = :gen_tcp.recv(socket, 0, 30_000)
    end

    test "accepts a body in pieces after 100 Continue" do
      {_, port} = start([{:post, "/echo", &echo/1}])
      socket = Raw.connect(port)
      headers = [{"content-length", "6"}, {"expect", "100-continue"}]
      :ok = :gen_tcp.send(socket, Raw.head("POST", "/echo", port, headers))
      assert {:ok, "HTTP/1.1 100 Continue\r\n\r\n"} = :gen_tcp.recv(socket, 25, 30_000)
      for piece <- ["ab", "cd", "ef"], do: :gen_tcp.send(socket, piece)
      assert {200, _, "POST abcdef"} = Raw.response(socket)
    end

    test "rejects a body above the limit before reading it" do
      {_, port} = start([{:post, "/echo", &echo/1, max_body: 100}], max_body: 10)
      assert {200, _, _} = Raw.post(port, "/echo", String.duplicate("a", 100))
      head = Raw.head("POST", "/echo", port, [{"content-length", "101"}])
      assert {413, %{"connection" => "close"}, _} = Raw.request(port, head)
      head = Raw.head("POST", "/echo", port, [{"content-length", "999999999999999"}])
      assert {413, _, _} = Raw.request(port, head)
    end

    test "limits the head by lines and bytes, but not the memory of a handler" do
      {_, port} =
        start([
          {:get, "/", &Response.text(inspect(map_size(&1.headers)))},
          {:get, "/heavy", fn _ -> 1..3_000_000 |> Enum.to_list() |> length() |> heavy() end}
        ])

      lines = fn n, bytes -> for i <- 1..n, do: {"x-#{i}", String.duplicate("a", bytes)} end
      assert {200, _, "9"} = Raw.get(port, "/", lines.(8, 8_000))
      assert {200, _, "65"} = Raw.get(port, "/", lines.(64, 64))

      for {n, bytes} <- [{100, 8_000}, {900, 1_000}] do
        socket = Raw.connect(port)
        # The server may close the connection while the test is writing.
        _ = :gen_tcp.send(socket, Raw.head("GET", "/", port, lines.(n, bytes)))
        assert {:error, reason} = :gen_tcp.recv(socket, 0, 30_000)
        assert reason in [:closed, :econnreset]
      end

      socket = Raw.connect(port)

      for _ <- 1..3 do
        :ok = :gen_tcp.send(socket, Raw.head("GET", "/heavy", port, []))
        assert {200, _, "3000000"} = Raw.response(socket)
      end
    end

    test "rejects malformed requests" do
      {_, port} = start([{:any, "/*rest", &echo/1}])

      for {expected, head} <- [
            {400, Raw.head("GET", "/%ff", port, [])},
            {400, Raw.head("GET", "/a%00b", port, [])},
            {400, Raw.head("GET", "/?a=%ff", port, [])},
            {400, Raw.head("POST", "/", port, [{"content-length", "-1"}])},
            {400, Raw.head("POST", "/", port, [{"content-length", "1x"}])},
            {411, Raw.head("POST", "/", port, [{"transfer-encoding", "chunked"}])},
            {400, Raw.head("POST", "/", port, [{"content-length", "1"}, {"content-length", "2"}])}
          ] do
        assert {^expected, _, _} = Raw.request(port, head)
      end

      capture_log(fn ->
        for text <- [
              "rubbish\r\n\r\n",
              <<0, 1, 2, 255, "\r\n\r\n">>,
              "GET / HTTP/9.9\r\nx\r\n\r\n"
            ] do
          assert match?({status, _, _} when status >= 400, Raw.request(port, text)) or
                   Raw.request(port, text) == :closed
        end

        many = for i <- 1..2_000, do: {"x-#{i}", "y"}
        refute match?({200, _, _}, Raw.get(port, "/", many))
        refute match?({200, _, _}, Raw.get(port, "/" <> String.duplicate("a", 100_000)))
      end)

      assert {200, _, _} = Raw.get(port, "/")
    end

    test "a handler that raises fails only its own request" do
      {_, port} =
        start([{:get, "/raise", fn _ -> raise "boom" end}, {:get, "/bad", fn _ -> :what end}])

      log =
        capture_log(fn ->
          assert {500, _, "500 internal error\n"} = Raw.get(port, "/raise")
          assert {500, _, _} = Raw.get(port, "/bad")
        end)

      assert log =~ "boom"
      assert {404, _, _} = Raw.get(port, "/")
    end

    test "a header with a line break stays one header" do
      handler = fn _ -> "x" |> Response.text() |> Response.put_header("x-a", "1\r\nx-b: 2") end
      {_, port} = start([{:get, "/", handler}])
      assert {200, %{"x-a" => "1  x-b: 2"} = headers, "x"} = Raw.get(port, "/")
      refute is_map_key(headers, "x-b")
    end

    test "sends chunks as they are produced" do
      {_, port} = start([{:get, "/", fn _ -> %Response{body: {:chunks, ["ab", "", "c"]}} end}])
      whole = Raw.collect(port, Raw.head("GET", "/", port, []), "0\r\n\r\n")
      assert whole =~ "transfer-encoding: chunked\r\n"
      assert String.ends_with?(whole, "\r\n\r\n2\r\nab\r\n1\r\nc\r\n0\r\n\r\n")
    end
  end

  describe "files" do
    setup %{tmp_dir: dir} do
      root = Path.join(dir, "public")
      File.mkdir_p!(Path.join(root, "sub"))
      File.write!(Path.join(root, "a.txt"), "0123456789")
      File.write!(Path.join(root, "sub/é x.js"), "js")
      File.write!(Path.join(root, ".hidden"), "hidden")
      File.write!(Path.join(root, "big.js"), "plain")
      File.write!(Path.join(root, "big.js.gz"), "gzipped")
      File.write!(Path.join(dir, "secret.txt"), "secret")
      File.ln_s!(Path.join(dir, "secret.txt"), Path.join(root, "out.txt"))
      File.ln_s!("/", Path.join(root, "slash"))
      File.ln_s!("a.txt", Path.join(root, "in.txt"))
      {_, port} = start([{:static, "/files", root}])
      {:ok, port: port}
    end

    test "are served with type, tag and ranges", %{port: port} do
      assert {200, headers, "0123456789"} = Raw.get(port, "/files/a.txt")
      assert headers["content-type"] =~ "text/plain"
      assert {304, _, ""} = Raw.get(port, "/files/a.txt", [{"if-none-match", headers["etag"]}])

      assert {206, %{"content-range" => "bytes 2-4/10"}, "234"} =
               Raw.get(port, "/files/a.txt", [{"range", "bytes=2-4"}])

      assert {206, _, "89"} = Raw.get(port, "/files/a.txt", [{"range", "bytes=-2"}])
      assert {206, _, "9"} = Raw.get(port, "/files/a.txt", [{"range", "bytes=9-100"}])
      assert {416, _, _} = Raw.get(port, "/files/a.txt", [{"range", "bytes=10-"}])
      assert {200, _, _} = Raw.get(port, "/files/a.txt", [{"range", "bytes=1-2,4-5"}])
      assert {200, _, _} = Raw.get(port, "/files/a.txt", [{"range", "rubbish"}])
      assert {200, _, "js"} = Raw.get(port, "/files/sub/%C3%A9%20x.js")
      assert {200, _, "0123456789"} = Raw.get(port, "/files/in.txt")

      assert {200, headers, "gzipped"} =
               Raw.get(port, "/files/big.js", [{"accept-encoding", "gzip"}])

      assert headers["content-encoding"] == "gzip" and headers["content-type"] =~ "javascript"
      assert {200, _, "plain"} = Raw.get(port, "/files/big.js")
    end

    test "outside the folder are not found", %{port: port} do
      for path <- [
            "/files/../secret.txt",
            "/files/%2e%2e/secret.txt",
            "/files/..%2fsecret.txt",
            "/files/sub/../../secret.txt",
            "/files/%2e%2e%2fsecret.txt",
            "/files/..%5csecret.txt",
            "/files//etc/passwd",
            "/files/slash/etc/passwd",
            "/files/out.txt",
            "/files/.hidden",
            "/files/a.txt%00",
            "/files/a.txt%00.js",
            "/files/sub",
            "/files/",
            "/files",
            "/files/nope"
          ] do
        {status, _, body} = Raw.get(port, path)
        assert status in [400, 404], path
        refute body =~ "secret"
      end
    end
  end

  describe "the gate" do
    test "rejects a foreign host name (DNS rebinding)" do
      {_, port} = start([{:get, "/", &echo/1}])
      assert {200, _, _} = Raw.get(port, "/")
      assert {200, _, _} = Raw.get(port, "/", [{"host", "127.0.0.1:#{port}"}])
      assert {421, _, _} = Raw.get(port, "/", [{"host", "evil.example:#{port}"}])
      assert {421, _, _} = Raw.get(port, "/", [{"host", ""}])

      assert {421, _, _} =
               Raw.request(port, "GET / HTTP/1.1\r\nhost: localhost\r\nhost: evil\r\n\r\n")
    end

    test "a foreign origin may not write" do
      {_, port} = start([{:post, "/", &echo/1}])
      own = "http://localhost:#{port}"
      assert {200, _, _} = Raw.post(port, "/", "", [{"origin", own}])
      assert {200, _, _} = Raw.post(port, "/", "")

      for origin <- ["http://evil.example", "null", "http://localhost", own <> ".evil.example"],
          do: assert({403, _, _} = Raw.post(port, "/", "", [{"origin", origin}]))
    end

    test "accepts a token in the address, a cookie or a bearer header" do
      {server, port} = start([{:get, "/a b", &echo/1}], token: "a good token")
      assert Situ.Live.url(server, "/") == "http://localhost:#{port}/?token=a+good+token"
      assert {401, _, _} = Raw.get(port, "/a%20b")
      assert {401, _, _} = Raw.get(port, "/a%20b?token=wrong")
      assert {401, _, _} = Raw.get(port, "/a%20b?token[]=a+good+token")
      assert {401, _, _} = Raw.get(port, "/a%20b", [{"cookie", "situ_#{port}=x.y"}])
      assert {401, _, _} = Raw.get(port, "/a%20b", [{"authorization", "Bearer no"}])
      assert {200, _, _} = Raw.get(port, "/a%20b", [{"authorization", "Bearer a good token"}])

      assert {303, headers, _} = Raw.get(port, "/a%20b?x=1&token=a+good+token")
      assert headers["location"] == "/a%20b?x=1"
      assert headers["set-cookie"] =~ "HttpOnly; SameSite=Strict"
      [cookie | _] = String.split(headers["set-cookie"], ";")
      assert {200, _, _} = Raw.get(port, "/a%20b", [{"cookie", cookie}])

      {_, other} = start([{:get, "/", &echo/1}], token: "another token")

      assert {401, _, _} =
               Raw.get(other, "/", [{"cookie", String.replace(cookie, "#{port}", "#{other}")}])
    end

    test "a browser without a valid token gets a form that keeps the address" do
      {_, port} = start([{:get, "/", &echo/1}], token: "a good token")
      html = [{"accept", "text/html,*/*;q=0.8"}]
      assert {401, headers, page} = Raw.get(port, "/?view=1%222%3E&list[]=x", html)
      assert headers["content-type"] =~ "text/html"
      assert headers["content-security-policy"] =~ "default-src 'none'"
      assert page =~ "This page needs a token."
      assert page =~ ~s(<input type="hidden" name="view" value="1&quot;2&gt;">)
      refute page =~ "list"
      assert {401, _, page} = Raw.get(port, "/?token=wrong", html)
      assert page =~ "This token is not valid."
      refute page =~ "wrong"
      assert {401, %{"content-type" => "text/plain" <> _}, _} = Raw.get(port, "/")

      assert {303, %{"location" => "/?view=1"}, _} =
               Raw.get(port, "/?view=1&token=a+good+token", html)
    end

    test "requires a token beyond loopback" do
      routes = [{:get, "/", &echo/1}]

      assert {:error, %{code: :token_required}} =
               Situ.Live.start_link(port: 0, routes: routes, ip: {0, 0, 0, 0}, token: :none)

      assert {:error, %{code: :weak_token}} =
               Situ.Live.start_link(port: 0, routes: routes, token: "short")

      {server, port} = start(routes, ip: {0, 0, 0, 0})
      assert Situ.Live.url(server) =~ ~r/token=\S{24}/
      assert {401, _, _} = Raw.get(port, "/")
    end
  end

  describe "lifecycle" do
    test "a port in use is an error, and a stopped server releases its port" do
      {server, port} = start([{:get, "/", &echo/1}])
      Process.flag(:trap_exit, true)
      assert {:error, %{code: :port_in_use}} = Situ.Live.start_link(port: port, routes: [])
      assert_raise ArgumentError, ~r/unknown options/, fn -> Situ.Live.start_link(prot: 1) end
      {:ok, own} = Situ.Live.start_link(port: 0, routes: [{:get, "/", &echo/1}])
      own_port = Situ.Live.port(own)
      Supervisor.stop(own)
      assert {:error, :econnrefused} = :gen_tcp.connect(~c"localhost", own_port, [])
      assert {:ok, again} = Situ.Live.start_link(port: own_port, routes: [])
      Supervisor.stop(again)
      assert Process.alive?(server)
    end

    test "renders a page in its layout, escaped, with its content security policy" do
      {_, port} = start([{:live, "/", Demo.Main, session: %{"user" => "<ann>"}}])
      assert {200, headers, html} = Raw.get(port, "/?tab=<script>")
      assert headers["content-security-policy"] =~ "script-src 'self'"
      assert html =~ "<p id=\"user\">&lt;ann&gt;</p>"
      assert html =~ "<p id=\"tab\">&lt;script&gt;</p>"
      assert html =~ ~r/<div id="phx-[\w-]{12}" data-phx-main data-phx-session="[\w.-]+"/
    end
  end
end
