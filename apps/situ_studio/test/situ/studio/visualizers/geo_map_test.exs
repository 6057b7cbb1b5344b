defmodule Situ.Studio.Visualizers.GeoMapTest do
  use ExUnit.Case, async: true
  doctest Situ.Studio.Tiles
  alias Situ.GeoPoint
  alias Situ.Studio.{Asking, DataSession, History, Layout, StreamInfo, Tiles, Recordings}

  defp session(count) do
    history = History.new(live: false, seconds: 1_000_000)

    for i <- 0..(count - 1) do
      {:ok, place} = GeoPoint.new(46 + i / count, 14.5, accuracy: 3)
      data = if rem(i, 10) == 9, do: :lost, else: place
      History.put(history, "gps", Asking.message(1_000_000_000 * (i + 1), data, i), 8)
    end

    DataSession.new(Recordings.History.wrap(history))
  end

  defp way(session, to) do
    spec = %{"stream" => "gps", "viz" => "map"}
    series = [[1, "0", "#{to}", 1_000_000_000_000]]
    {%{frames: [frame]}, _} = Asking.ask(session, %{"open" => [[1, spec]], "series" => series})
    assert frame.kind == 10
    <<8::little-32, n::little-32, "latitude", _::binary>> = frame.payload
    {n, frame}
  end

  test "draws a track as two lines, without values that are not positions" do
    assert {90, %{rows: 2, flags: 1}} = way(session(100), 100_000_000_000)
  end

  test "draws a part of a long track, and reports that it is a part" do
    {n, frame} = way(session(20_000), 20_000_000_000_000)
    assert n in 2_000..5_001
    assert frame.flags == 2
  end

  test "returns the position at the cursor, or an explanation" do
    spec = %{"stream" => "gps", "viz" => "map"}

    ask = fn at ->
      request = %{"open" => [[1, spec]], "instant" => [1], "at" => at}
      {%{frames: [frame]}, _} = Asking.ask(session(100), request)
      frame
    end

    assert %{"latitude" => 46.0, "accuracy" => 3.0} = Asking.json(ask.("1000000000").payload)
    assert %{kind: 8, payload: text} = ask.("10000000000")
    assert text =~ "needs a latitude and a longitude"
  end

  test "recognizes streams of positions, and puts them on one map" do
    assert StreamInfo.shape_of_type(GeoPoint) == :place
    assert StreamInfo.shape_of(%{"latitude" => 1, "longitude" => 2, "altitude" => 3}) == :place
    streams = for name <- ["a", "b"], do: %StreamInfo{name: name, shape: :place}
    assert [%{panel: :map, vis: [_, _]}] = Layout.Auto.build_layout(streams).panels
  end

  @tag :tmp_dir
  test "accepts tiles from an origin or an existing folder", %{tmp_dir: dir} do
    assert {:ok, tiles} = Tiles.new("http://localhost:8080/{z}/{x}/{y}.png", nil)
    assert Tiles.allowed_origins(tiles) == ["http://localhost:8080"]
    assert {:ok, %{url: "/tiles/{z}/{x}/{y}.png"} = tiles} = Tiles.new(dir, nil)

    assert Tiles.allowed_origins(tiles) == [] and
             Tiles.tile_routes(tiles) == [{:static, "/tiles", dir}]

    for bad <- [
          "nowhere",
          "javascript:alert(1)",
          "https://a b/{z}{x}{y}",
          "https://x;script/{z}{x}{y}"
        ],
        do: assert({:error, %{code: :bad_tiles}} = Tiles.new(bad, nil))
  end

  test "the page's policy allows images of that origin only" do
    url = "https://tile.example.org/{z}/{x}/{y}.png"
    {:ok, studio} = Situ.Studio.start_link(id: "tiles-test", port: 0, tiles: url)

    {:ok, socket} =
      :gen_tcp.connect({127, 0, 0, 1}, Situ.Studio.port(studio), [:binary, active: false])

    :ok = :gen_tcp.send(socket, "GET / HTTP/1.1\r\nhost: localhost\r\n\r\n")
    {:ok, answer} = :gen_tcp.recv(socket, 0, 10_000)
    assert answer =~ "img-src 'self' blob: data: https://tile.example.org;"
    assert answer =~ "script-src 'self';"
    Supervisor.stop(studio)
  end
end
