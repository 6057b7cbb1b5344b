defmodule Situ.Phoenix.StudioTest do
  # The studio in a Phoenix application, over real connections to Bandit and Cowboy.
  use ExUnit.Case, async: false
  alias Situ.Live.Raw
  alias Situ.Phoenix.TestApp

  @moduletag :capture_log
  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          store = Situ.Store.create(p, "first", dir)

          p
          |> Situ.from_enumerable([1.0, 2.0, 1.5], every: 10)
          |> Situ.Store.write(store, "Level")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    Application.put_env(:situ_phoenix, :recordings, dir)

    on_exit(fn ->
      for {_, studio, _, _} <- DynamicSupervisor.which_children(Situ.Phoenix.StudioSupervisor),
          do: DynamicSupervisor.terminate_child(Situ.Phoenix.StudioSupervisor, studio)
    end)
  end

  defp cookie(port, name) do
    {200, headers, _} = Raw.get(port, "/login/" <> name)
    {"cookie", headers["set-cookie"] |> String.split(";") |> hd()}
  end

  # The client loses a frame that arrives together with the response to its upgrade.
  defp refused(socket) do
    case Raw.receive_frame(socket) do
      {:close, <<1008::16, reason::binary>>} -> reason
      :closed -> "missing, view-only"
    end
  end

  defp assign(html, pattern), do: pattern |> Regex.run(html) |> List.last()

  for endpoint <- [TestApp.Bandit, TestApp.Cowboy] do
    describe inspect(endpoint) do
      setup do
        port = TestApp.start(unquote(endpoint))
        {:ok, port: port, user: cookie(port, "ada")}
      end

      test "requires the application's login for pages, files and sockets", %{
        port: port,
        user: user
      } do
        for path <- ["/lab/situ", "/lab/situ/assets/studio.js"],
            do: assert({302, %{"location" => "/login/ada"}, _} = Raw.get(port, path))

        assert {302, _, _} = Raw.upgrade(port, "/lab/situ/data/socket?source=first")
        assert {200, headers, html} = Raw.get(port, "/lab/situ", [user])
        assert html =~ ~s(<base href="/lab/situ/">)
        assert html =~ "first"
        assert headers["content-security-policy"] =~ "script-src 'self'"
        assert {404, _, _} = Raw.get(port, "/lab/situ/nothing/here", [user])
      end

      test "serves files, ranges and generated data", %{port: port, user: user} do
        assert {200, headers, js} = Raw.get(port, "/lab/situ/assets/studio.js", [user])
        assert headers["content-type"] =~ "javascript"

        assert {206, _, part} =
                 Raw.get(port, "/lab/situ/assets/studio.js", [user, {"range", "bytes=2-5"}])

        assert part == binary_part(js, 2, 4)

        assert {304, _, _} =
                 Raw.get(port, "/lab/situ/assets/studio.js", [
                   user,
                   {"if-none-match", headers["etag"]}
                 ])

        assert {400, _, _} = Raw.get(port, "/lab/situ/assets/../studio.js", [user])
        assert {200, _, svg} = Raw.get(port, "/lab/situ/data/thumbnail?source=first", [user])
        assert svg =~ "<svg"
      end

      test "a page joins over the application's socket, and draws", %{port: port, user: user} do
        {200, _, html} = Raw.get(port, "/lab/situ/s/first", [user])
        id = assign(html, ~r/id="(phx-[^"]+)" data-phx-main/)
        session = assign(html, ~r/data-phx-session="([^"]+)"/)
        {:ok, socket} = Raw.upgrade(port, "/lab/situ/live/websocket?vsn=2.0.0", [user])
        join = %{"url" => "http://localhost:#{port}/lab/situ/s/first", "session" => session}
        Raw.send_text(socket, Situ.JSON.encode(["1", "1", "lv:" <> id, "phx_join", join]))
        assert {:text, answer} = Raw.receive_frame(socket)
        assert {:ok, [_, _, _, "phx_reply", %{"status" => "ok"}]} = Situ.JSON.decode(answer)

        {:ok, data} = Raw.upgrade(port, "/lab/situ/data/socket?source=first", [user])
        Raw.send_text(data, "not a request")
        assert {:close, <<_status::16, _::binary>>} = Raw.receive_frame(data)
        {:ok, missing} = Raw.upgrade(port, "/lab/situ/data/socket?source=missing", [user])
        assert refused(missing) =~ "missing"
      end

      test "rejects foreign hosts and origins, and accepts the endpoint's own", %{
        port: port,
        user: user
      } do
        socket = "/lab/situ/data/socket?source=first"
        assert {421, _, _} = Raw.get(port, "/lab/situ", [user, {"host", "evil.example"}])
        assert {200, _, _} = Raw.get(port, "/lab/situ", [user, {"host", "lab.example.org"}])
        assert {403, _, _} = Raw.upgrade(port, socket, [user, {"origin", "https://evil.example"}])
        assert {:ok, _} = Raw.upgrade(port, socket, [user, {"origin", "https://lab.example.org"}])

        assert {:ok, _} =
                 Raw.upgrade(port, socket, [user, {"origin", "http://localhost:#{port}"}])
      end

      test "a second studio has its own viewers", %{port: port, user: user} do
        assert {200, _, html} = Raw.get(port, "/lab/guests", [user])
        assert html =~ ~s(<base href="/lab/guests/">)
        guest = cookie(port, "guest")
        assert {:ok, socket} = Raw.upgrade(port, "/lab/guests/sensor/socket", [guest])
        assert refused(socket) =~ "view-only"
      end
    end
  end

  test "a studio whose server has failed, or which has ended, is found again" do
    fetch = fn -> Situ.Phoenix.Studios.fetch_server("/failing", []) end
    {:ok, server} = fetch.()
    kill(server)
    {:ok, again} = wait_until_ok(fetch)
    assert again != server

    [studio] =
      for {_, pid, _, _} <- DynamicSupervisor.which_children(Situ.Phoenix.StudioSupervisor),
          do: pid

    assert Situ.Studio.live_server(studio) == again
    monitor = Process.monitor(again)
    kill(studio)
    assert_receive {:DOWN, ^monitor, _, _, _}, 10_000
    assert {:ok, last} = wait_until_ok(fetch)
    assert last != again
  end

  defp kill(pid) do
    monitor = Process.monitor(pid)
    Process.exit(pid, :kill)
    assert_receive {:DOWN, ^monitor, _, _, _}, 10_000
  end

  # The table forgets a server shortly after it has ended.
  defp wait_until_ok(fetch) do
    with {:ok, server} <- fetch.(), true <- Process.alive?(server) do
      {:ok, server}
    else
      _ -> wait_until_ok(fetch)
    end
  end

  test "a studio that cannot start says why" do
    conn = %{Plug.Test.conn(:get, "/") | script_name: ["broken"], path_info: []}
    assert %{status: 500, resp_body: body} = Situ.Phoenix.Plug.call(conn, port: 1, nonsense: true)
    assert body =~ "nonsense"
  end
end
