defmodule Situ.Live.AdapterTest do
  # A server without a port, whose requests come from another web server.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  alias Situ.Live.{Adapter, Connections, Request, Response, SocketConnection}

  # An adapter whose connection is the body that the client sends, and whose result is a term.
  defmodule Memory do
    @behaviour Adapter
    @impl true
    def read_body(:slow, _config, _request, _length), do: {:error, 408}
    def read_body(body, _config, _request, length), do: {:ok, binary_part(body, 0, length), ""}
    @impl true
    def send_response(_connection, _config, _request, {response, body_read?}),
      do: {response.status, IO.iodata_to_binary(response.body), body_read?}

    @impl true
    def upgrade_connection(_connection, socket, max_frame), do: {socket, max_frame}
  end

  defmodule Echo do
    @behaviour Situ.Live.SocketHandler
    @impl true
    def init(%{query: %{"refuse" => reason}}, _arg), do: {:error, reason}
    def init(_request, arg), do: {:push, {:text, ["hello ", arg]}, arg}
    @impl true
    def handle_in({"raise", _}, _state), do: raise("boom")
    def handle_in({"stop", _}, state), do: {:stop, :normal, state}
    def handle_in({data, opcode: opcode}, state), do: {:push, [{opcode, data}], state}
  end

  setup do
    routes = [
      {:get, "/role", &Response.text(to_string(&1.role))},
      {:post, "/length", &Response.text("#{byte_size(&1.body)}"), max_body: 10},
      {:get, "/raise", fn _ -> raise "boom" end},
      {:socket, "/echo", Echo, "ann", max_frame: 99}
    ]

    server = start_supervised!({Situ.Live, port: :none, prefix: "/lab/pages", routes: routes})
    {:ok, server: server, config: Adapter.fetch_config!(server)}
  end

  defp serve(config, method, target, headers \\ %{}, opts \\ []) do
    headers = Map.put_new(headers, "host", "localhost:4000")
    {:ok, request} = Request.new(method, target, headers, role: opts[:role] || :owner)
    Adapter.serve_request(Memory, opts[:body] || "", config, request)
  end

  @upgrade %{
    "upgrade" => "websocket",
    "sec-websocket-version" => "13",
    "sec-websocket-key" => "k"
  }

  test "has no port, and addresses below its prefix", %{server: server} do
    assert Situ.Live.port(server) == :none
    assert Situ.Live.url(server, "/role") == "/lab/pages/role"
  end

  test "serves requests with and without the prefix, in the role that the adapter sets", %{
    config: config
  } do
    assert serve(config, "GET", "/lab/pages/role") == {200, "owner", true}
    assert serve(config, "GET", "/role", %{}, role: :viewer) == {200, "viewer", true}
    assert {404, _, true} = serve(config, "GET", "/elsewhere/role")
    assert capture_log(fn -> assert {500, _, true} = serve(config, "GET", "/raise") end) =~ "boom"
  end

  test "checks host names and origins, which the adapter may replace", %{config: config} do
    evil = %{"host" => "evil.example"}
    assert {421, _, _} = serve(config, "GET", "/role", evil)

    open =
      Adapter.allow(config, hosts: :any, scheme: "https", origins: ["https://lab.example.org"])

    assert {200, _, _} = serve(open, "GET", "/role", evil)
    foreign = Map.put(@upgrade, "origin", "https://lab.example.org")
    assert {403, _, _} = serve(config, "GET", "/echo", foreign)
    assert {%SocketConnection{}, 99} = serve(open, "GET", "/echo", foreign)
  end

  test "limits bodies before they are read", %{config: config} do
    post = &serve(config, "POST", "/length", %{"content-length" => &1}, body: &2)
    assert post.("3", "abc") == {200, "3", true}
    assert {413, _, false} = post.("11", "abcdefghijk")
    assert {400, _, false} = post.("-1", "")
    assert {408, _, false} = post.("3", :slow)
    assert {411, _, false} = serve(config, "POST", "/length", %{"transfer-encoding" => "chunked"})
  end

  test "a WebSocket is a value that the adapter drives", %{config: config} do
    assert {426, _, _} = serve(config, "GET", "/echo", Map.delete(@upgrade, "sec-websocket-key"))
    {socket, 99} = serve(config, "GET", "/echo", @upgrade)
    assert {:send, [{:text, "hello ann"}], socket} = SocketConnection.open(socket)
    assert Connections.list_pids(config.ref) == [self()]
    assert {:send, [{:binary, "x"}], socket} = SocketConnection.handle_frame(socket, :binary, "x")
    assert {:send, [], socket} = SocketConnection.handle_info(socket, :anything)
    assert {:close, {1000, ""}, _} = SocketConnection.handle_frame(socket, :text, "stop")

    assert capture_log(fn ->
             assert {:close, {1011, _}, _} = SocketConnection.handle_frame(socket, :text, "raise")
           end) =~ "boom"

    assert SocketConnection.terminate(socket, :closed) == :ok
    {socket, 99} = serve(config, "GET", "/echo?refuse=full", @upgrade)
    assert {:close, {1008, "full"}, _} = SocketConnection.open(socket)
  end

  test "a public address and a prefix exclude each other" do
    opts = [port: :none, routes: [], public: "https://lab.example.org", prefix: "/a"]
    assert {:error, %{code: :bad_prefix, fix: fix}} = Situ.Live.start_link(opts)
    assert fix =~ "https://lab.example.org/a"

    assert {:error, %{code: :bad_prefix}} =
             Situ.Live.start_link(port: :none, routes: [], prefix: "a b")
  end
end
