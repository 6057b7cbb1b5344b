defmodule Situ.Live.SocketTest do
  # Tests WebSockets from outside, through raw sockets: which requests are rejected, and that other clients continue.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  alias Situ.JSON
  alias Situ.Live.{Connections, Demo, Raw, ViewServer}

  defmodule Echo do
    @behaviour Situ.Live.SocketHandler

    @impl true
    def init(_request, test) do
      send(test, {:open, self()})
      {:ok, test}
    end

    @impl true
    def handle_in({"raise", _}, _), do: raise("boom")
    def handle_in({"stop", _}, state), do: {:stop, :normal, state}
    def handle_in({data, opcode: opcode}, state), do: {:push, {opcode, data}, state}

    @impl true
    def handle_info({:push, n}, state), do: {:push, {:binary, :binary.copy("x", n)}, state}

    @impl true
    def terminate(_reason, test), do: send(test, {:closed, self()})
  end

  setup_all do
    {:ok, server} =
      Situ.Live.start_link(
        port: 0,
        max_sockets: 40,
        routes: [
          {:live, "/", Demo.Main, session: %{"user" => "ann"}},
          {:live, "/raises", Demo.Raises},
          {:live, "/again", Demo.Main, session: %{"user" => "ann"}},
          {:live, "/guarded", Demo.Main, session: fn _request -> raise "not for you" end},
          {:socket, "/ws", Echo, self()}
        ]
      )

    {:ok, server: server, port: Situ.Live.port(server)}
  end

  defp echo(opts \\ []) do
    server =
      start_supervised!({Situ.Live, [port: 0, routes: [{:socket, "/ws", Echo, self(), opts}]]})

    port = Situ.Live.port(server)
    {:ok, socket} = Raw.upgrade(port, "/ws")
    assert_receive {:open, pid}
    {socket, pid, port, server}
  end

  describe "frames" do
    test "handles text, binary, fragments, pings and close" do
      {socket, _, _, _} = echo()
      Raw.send_text(socket, "é")
      assert Raw.receive_frame(socket) == {:text, "é"}
      :gen_tcp.send(socket, Raw.frame(2, :binary.copy("ab", 20_000)))
      assert {:binary, bytes} = Raw.receive_frame(socket)
      assert byte_size(bytes) == 40_000
      :gen_tcp.send(socket, [Raw.frame(1, "a", 0), Raw.frame(9, "hi"), Raw.frame(0, "b", 1)])
      assert Raw.receive_frame(socket) == {:pong, "hi"}
      assert Raw.receive_frame(socket) == {:text, "ab"}
      :gen_tcp.send(socket, Raw.frame(8, <<1000::16>>))
      assert {:close, <<1000::16>>} = Raw.receive_frame(socket)
      assert Raw.receive_frame(socket) == :closed
      assert_receive {:closed, _}
    end

    test "accepts one byte at a time" do
      {socket, _, _, _} = echo()
      for <<c <- Raw.frame(1, "slow")>>, do: :ok = :gen_tcp.send(socket, <<c>>)
      assert Raw.receive_frame(socket) == {:text, "slow"}
    end

    test "rejects frames that are too large, unmasked, not UTF-8 or not in the protocol" do
      capture_log(fn ->
        {_, _, port, _} = echo(max_frame: 1_000)

        for {code, bytes} <- [
              {1009, Raw.frame(2, :binary.copy("x", 1_001))},
              {1009,
               [Raw.frame(2, :binary.copy("x", 900), 0), Raw.frame(0, :binary.copy("x", 900), 1)]},
              {1002, <<1::1, 0::3, 1::4, 0::1, 2::7, "hi">>},
              {1007, Raw.frame(1, <<255, 254>>)},
              {1002, Raw.frame(3, "?")},
              {1002, Raw.frame(0, "x")}
            ] do
          {:ok, socket} = Raw.upgrade(port, "/ws")
          :ok = :gen_tcp.send(socket, bytes)
          assert {:close, <<^code::16, _::binary>>} = Raw.receive_frame(socket)
        end
      end)
    end

    test "a handler that raises closes only its own connection" do
      {socket, _, port, _} = echo()
      {:ok, other} = Raw.upgrade(port, "/ws")

      log =
        capture_log(fn ->
          Raw.send_text(socket, "raise")
          assert {:close, <<1011::16, _::binary>>} = Raw.receive_frame(socket)
        end)

      assert log =~ "boom"
      Raw.send_text(other, "here")
      assert Raw.receive_frame(other) == {:text, "here"}
      Raw.send_text(other, "stop")
      assert {:close, <<1000::16>>} = Raw.receive_frame(other)
    end

    test "times out an unfinished frame" do
      capture_log(fn ->
        {socket, _, _, _} = echo()
        :gen_tcp.send(socket, binary_part(Raw.frame(1, "never whole"), 0, 8))
        # Newer versions of Yaws close without a close frame.
        assert Raw.receive_frame(socket, 10_000) in [:closed, {:close, <<1000::16>>}]
        assert_receive {:closed, _}
      end)
    end

    test "closes an idle connection" do
      {socket, pid, _, server} = echo()
      ref = Situ.Live.get_endpoint(server).ref
      assert Connections.kill_idle(ref, 60_000) == 0
      monitor = Process.monitor(pid)
      assert Connections.kill_idle(ref, -1) == 1
      assert_receive {:DOWN, ^monitor, _, _, :killed}
      assert Raw.receive_frame(socket) == :closed
    end

    test "a browser that does not read blocks only its own process" do
      {_socket, pid, port, _} = echo()
      for _ <- 1..40, do: send(pid, {:push, 1_000_000})
      {:ok, other} = Raw.upgrade(port, "/ws")
      Raw.send_text(other, "here")
      assert Raw.receive_frame(other) == {:text, "here"}
    end

    test "a stopping server closes its connections" do
      {_socket, pid, _, _} = echo()
      monitor = Process.monitor(pid)
      stop_supervised!({Situ.Live, 0})
      assert_receive {:DOWN, ^monitor, _, _, _}
    end
  end

  describe "the upgrade" do
    test "requires the right headers", %{port: port} do
      assert {426, %{"upgrade" => "websocket"}, _} = Raw.get(port, "/live/websocket")
      headers = [{"upgrade", "websocket"}, {"connection", "upgrade"}]
      assert {426, %{"sec-websocket-version" => "13"}, _} = Raw.get(port, "/ws", headers)
    end

    test "rejects foreign origins and hosts", %{port: port} do
      assert {:ok, _} = Raw.upgrade(port, "/ws", [{"origin", "http://localhost:#{port}"}])

      for path <- ["/ws", "/live/websocket?vsn=2.0.0"],
          origin <- ["http://evil.example", "null", "https://localhost:#{port}", ""] do
        assert {403, _, _} = Raw.upgrade(port, path, [{"origin", origin}])
      end

      assert {421, _, _} = Raw.upgrade(port, "/ws", [{"host", "evil.example"}])
    end

    test "rejects a request without the token" do
      routes = [{:socket, "/ws", Echo, self()}]
      server = start_supervised!({Situ.Live, port: 0, token: "a good token", routes: routes})
      port = Situ.Live.port(server)
      assert {401, _, _} = Raw.upgrade(port, "/ws")
      assert {401, _, _} = Raw.upgrade(port, "/live/websocket")
      assert {:ok, _} = Raw.upgrade(port, "/ws", [{"authorization", "Bearer a good token"}])
    end

    test "rejects connections beyond the limit" do
      routes = [{:socket, "/ws", Echo, self()}]
      server = start_supervised!({Situ.Live, port: 0, max_sockets: 2, routes: routes})
      port = Situ.Live.port(server)
      {:ok, first} = Raw.upgrade(port, "/ws")
      assert_receive {:open, pid}
      {:ok, _} = Raw.upgrade(port, "/ws")
      assert_receive {:open, _}
      assert {503, _, _} = Raw.upgrade(port, "/ws")
      monitor = Process.monitor(pid)
      :gen_tcp.close(first)
      assert_receive {:DOWN, ^monitor, _, _, _}
      assert {:ok, _} = Raw.upgrade(port, "/ws")
    end
  end

  describe "the live protocol" do
    defp join(port, path \\ "/") do
      {200, _, html} = Raw.get(port, path)

      [_, id, token] =
        Regex.run(~r/id="(phx-[^"]+)" data-phx-main data-phx-session="([^"]+)"/, html)

      {:ok, socket} = Raw.upgrade(port, "/live/websocket?vsn=2.0.0")
      {socket, id, token}
    end

    defp push(socket, message), do: Raw.send_text(socket, JSON.encode(message))

    defp take(socket) do
      case Raw.receive_frame(socket) do
        {:text, text} -> text |> JSON.decode() |> elem(1)
        other -> other
      end
    end

    defp joined(port) do
      {socket, id, token} = join(port)
      url = "http://localhost:#{port}/"
      push(socket, ["1", "1", "lv:" <> id, "phx_join", %{url: url, session: token}])

      assert ["1", "1", _, "phx_reply", %{"status" => "ok", "response" => response}] =
               take(socket)

      assert %{"rendered" => %{"s" => _}, "liveview_version" => "1.2.12"} = response
      assert ["1", nil, _, "diff", %{"e" => _}] = take(socket)
      {socket, "lv:" <> id}
    end

    test "handles join, event, heartbeat and leave", %{port: port} do
      {socket, topic} = joined(port)
      push(socket, [nil, "2", "phoenix", "heartbeat", %{}])
      assert [nil, "2", "phoenix", "phx_reply", %{"status" => "ok"}] = take(socket)
      push(socket, ["1", "3", topic, "event", %{type: "click", event: "inc", value: %{}}])
      assert ["1", "3", ^topic, "phx_reply", %{"response" => %{"diff" => diff}}] = take(socket)
      assert JSON.encode(diff) =~ "1"
      push(socket, ["1", "4", topic, "phx_leave", %{}])
      assert ["1", "4", ^topic, "phx_reply", %{"status" => "ok"}] = take(socket)
      assert ["1", "1", ^topic, "phx_close", _] = take(socket)
      push(socket, ["1", "5", topic, "event", %{type: "click", event: "inc", value: %{}}])
      assert ["1", "5", ^topic, "phx_reply", %{"status" => "error"}] = take(socket)
    end

    test "a wrong, changed or missing token or another address is stale", %{port: port} do
      {socket, id, token} = join(port)
      url = "http://localhost:#{port}/"

      for {id, payload} <- [
            {"phx-other", %{url: url, session: token}},
            {id, %{url: url, session: token <> "x"}},
            {id, %{url: url}},
            {id, %{url: url <> "nope", session: token}},
            {id, %{url: nil, session: token}},
            {id, %{url: 7, session: 7}}
          ] do
        push(socket, ["1", "1", "lv:" <> id, "phx_join", payload])

        assert [
                 "1",
                 "1",
                 _,
                 "phx_reply",
                 %{"status" => "error", "response" => %{"reason" => "stale"}}
               ] = take(socket)
      end
    end

    test "a page's token joins only pages of the same fixed session", %{
      port: port
    } do
      for {path, status} <- [{"again", "ok"}, {"guarded", "error"}, {"raises", "error"}] do
        {socket, id, token} = join(port)
        url = "http://localhost:#{port}/#{path}"
        push(socket, ["1", "1", "lv:" <> id, "phx_join", %{redirect: url, session: token}])
        assert ["1", "1", _, "phx_reply", %{"status" => ^status}] = take(socket)
      end
    end

    test "a mount that raises fails the join", %{port: port} do
      {socket, id, token} = join(port, "/raises")
      url = "http://localhost:#{port}/raises"

      capture_log(fn ->
        push(socket, ["1", "1", "lv:" <> id, "phx_join", %{url: url, session: token}])

        assert ["1", "1", _, "phx_reply", %{"status" => "error", "response" => response}] =
                 take(socket)

        assert response == %{"reason" => "join crashed"}
      end)
    end

    test "a view that raises sends phx_error, and other views continue", %{port: port} do
      {socket, topic} = joined(port)
      {other, other_topic} = joined(port)

      capture_log(fn ->
        push(socket, ["1", "2", topic, "event", %{type: "click", event: "crash", value: %{}}])
        assert ["1", "1", ^topic, "phx_error", %{}] = take(socket)
      end)

      push(other, ["1", "2", other_topic, "event", %{type: "click", event: "inc", value: %{}}])
      assert ["1", "2", _, "phx_reply", %{"status" => "ok"}] = take(other)
    end

    test "an invalid message closes the connection", %{port: port} do
      for bad <- [
            "",
            "x",
            "{}",
            "[]",
            "[1,2,3,4,5]",
            ~s(["1","1","lv:x","event"]),
            ~s([{},"1","lv:x","phx_join",{}]),
            ~s(["1","1","lv:x","phx_join",7]),
            String.duplicate("[", 10_000)
          ] do
        {:ok, socket} = Raw.upgrade(port, "/live/websocket?vsn=2.0.0")
        Raw.send_text(socket, bad)
        assert {:close, <<1007::16, _::binary>>} = take(socket)
      end

      {:ok, socket} = Raw.upgrade(port, "/live/websocket?vsn=2.0.0")
      :gen_tcp.send(socket, Raw.frame(2, "upload"))
      assert {:close, <<1003::16, _::binary>>} = take(socket)
    end

    test "an oversized form closes the connection, and others continue", %{port: port} do
      {socket, topic} = joined(port)
      {other, _} = joined(port)
      form = %{type: "form", event: "form", value: "f[q]=" <> String.duplicate("a", 1_000_001)}

      capture_log(fn ->
        push(socket, ["1", "2", topic, "event", form])
        assert {:close, <<1009::16, _::binary>>} = take(socket)
      end)

      push(other, [nil, "2", "phoenix", "heartbeat", %{}])
      assert [nil, "2", "phoenix", "phx_reply", _] = take(other)
    end

    test "a join replaces the view joined under the same topic", %{port: port} do
      {socket, id, token} = join(port)
      payload = %{url: "http://localhost:#{port}/", session: token}
      for ref <- ["1", "2"], do: push(socket, [ref, ref, "lv:" <> id, "phx_join", payload])
      frames = for _ <- 1..3, do: take(socket)
      assert Enum.any?(frames, &match?(["2", "2", _, "phx_reply", %{"status" => "ok"}], &1))
      push(socket, ["1", "3", "lv:" <> id, "event", %{type: "click", event: "inc", value: %{}}])

      assert Stream.repeatedly(fn -> take(socket) end)
             |> Enum.find(&match?([_, "3", _, _, _], &1))
             |> List.last()
             |> Map.fetch!("status") == "error"
    end

    test "the view does not run ahead of a stalled reader", %{port: port, server: server} do
      {socket, id, token} = join(port)
      {:ok, socket2} = Raw.upgrade(port, "/live/websocket?vsn=2.0.0&situ_flow=1")
      :gen_tcp.close(socket)
      payload = %{url: "http://localhost:#{port}/", session: token}
      push(socket2, ["1", "1", "lv:" <> id, "phx_join", payload])
      assert ["1", "1" | _] = take(socket2)
      assert ["1", nil, _, "diff", %{"e" => events}] = take(socket2)
      assert ["situ:ack", %{}] in events
      view = view_of(server, id)
      for n <- 1..1_000, do: send(view, {:set, :tick, n})
      :sys.get_state(view)
      # Nothing more is sent without an acknowledgement.
      assert Raw.receive_frame(socket2, 100) == :timeout

      push(socket2, [
        "1",
        "2",
        "lv:" <> id,
        "event",
        %{type: "hook", event: "situ:ack", value: %{}}
      ])

      messages = for _ <- 1..2, do: take(socket2)
      assert [[_, nil, _, "diff", diff]] = Enum.filter(messages, &match?([_, nil | _], &1))
      assert JSON.encode(diff) =~ "1000"
    end

    defp view_of(server, id) do
      supervisor =
        GenServer.whereis(ViewServer.supervisor_name(Situ.Live.get_endpoint(server).ref))

      supervisor
      |> DynamicSupervisor.which_children()
      |> Enum.find_value(fn {_, pid, _, _} -> :sys.get_state(pid).socket.id == id && pid end)
    end
  end
end
