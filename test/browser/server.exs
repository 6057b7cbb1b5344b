# Starts the studios of the browser tests and prints their addresses. Ends with its standard input
# or with a signal.
Code.require_file("fixture.exs", __DIR__)
Code.require_file("random_fixture.exs", __DIR__)
Code.require_file("window_fixture.exs", __DIR__)
Code.require_file("space_fixture.exs", __DIR__)
Code.require_file("sensor_fixture.exs", __DIR__)
Code.require_file("headset_fixture.exs", __DIR__)
Code.require_file("../../apps/situ_studio/test/support/guide_plugin.ex", __DIR__)
Code.require_file("plugin_fixture.exs", __DIR__)
Code.require_file("map_fixture.exs", __DIR__)
Code.require_file("mask_fixture.exs", __DIR__)
Code.require_file("session_fixture.exs", __DIR__)
Code.require_file("experiment_fixture.exs", __DIR__)
Code.require_file("video_fixture.exs", __DIR__)
alias Situ.Studio.{History, Recordings}

[work | _] = System.argv()
{:ok, _} = Application.ensure_all_started(:situ_studio)

folder = Path.join(work, "recordings")
points = String.to_integer(System.get_env("POINTS") || "1000000")
random = Path.join(work, "random.json")
windows = Path.join(work, "windows.json")

File.mkdir_p!(folder)

# As many recordings as there are cores are written concurrently.
recordings =
  Task.async(fn ->
    [
      fn -> Fixture.record_big("big", folder, points) end,
      fn -> Fixture.record("minute", folder) end,
      fn -> RandomFixture.record(folder, random, 4) end,
      fn -> WindowFixture.record(folder, windows) end,
      fn -> SpaceFixture.record("space", folder) end,
      fn -> Fixture.film(folder) end,
      fn -> Fixture.record_zoo("zoo", folder, Path.join(work, "zoo.json")) end,
      fn -> Fixture.record_dense("dense", folder, Path.join(work, "dense.json")) end,
      fn -> Fixture.record_uneven("uneven", folder) end,
      fn -> Fixture.record_many("many", folder) end,
      # Recordings that are replaced or damaged while they are shown.
      fn -> Fixture.record("changing", folder) end,
      fn -> Fixture.record_uneven("broken", folder) end,
      # A recording that is deleted while it is shown.
      fn -> Fixture.record("doomed", folder) end
    ]
    |> Task.async_stream(& &1.(), timeout: :infinity, ordered: false)
    |> Stream.run()
  end)

Task.start_link(fn -> Fixture.record_live("growing", folder) end)

Task.await(recordings, :infinity)

# A study of three sessions: one recording, two concurrent recordings, and one whose recording is
# missing.
study = Path.join(folder, "study.json")
{:ok, dataset} = Situ.Dataset.new("Lobby study", file: study, autosave: true)

for {session, tags, partitions} <- [
      {"p01", ["pilot"], [{"Room", "minute.0000"}]},
      {"p02", ["english"], [{"Room", "minute.0000"}, {"Wearable", "uneven.0000"}]},
      {"p03", [], [{"Room", "lost.0000"}]}
    ],
    reduce: dataset do
  dataset ->
    {:ok, dataset} = Situ.Dataset.add_session(dataset, session, tags: tags)

    for {name, store} <- partitions, reduce: dataset do
      dataset ->
        path = Path.join(folder, store)
        {:ok, dataset} = Situ.Dataset.add_partition(dataset, session, name, path)
        dataset
    end
end

tasks = Application.get_env(:situ_dataset, :dataset_tasks)
Application.put_env(:situ_dataset, :dataset_tasks, [Fixture.Loudness | tasks])

sources = %{
  "memory" => Recordings.History.wrap(Fixture.minute()),
  "empty" => Recordings.History.wrap(History.new(live: false)),
  "walk" => Recordings.History.wrap(MapFixture.walk()),
  "masked" => Recordings.History.wrap(MaskFixture.found()),
  "gaze" => Recordings.History.wrap(PluginFixture.gaze()),
  "space-frames" => Recordings.History.wrap(SpaceFixture.frames()),
  "space-broken" => Recordings.History.wrap(SpaceFixture.broken()),
  "space-big" => Recordings.History.wrap(SpaceFixture.big(3_000_000))
}

# A live pipeline: 30 numbers per second, with an image and a level computed from each.
connector = Situ.Connector.new("clock")

{:ok, pipeline} =
  Situ.Pipeline.start(
    fn p ->
      clock =
        p
        |> Situ.Connector.receive(connector)
        |> Situ.map(& &1, name: "Clock.Count", type: :integer)

      Situ.map(clock, &Fixture.picture(rem(&1, 60)), name: "Camera.Image", type: Situ.Image)
      Situ.map(clock, &:math.sin(&1 / 20), name: "Level", type: :float)
    end,
    pipeline: [name: "Lobby"]
  )

ticker = fn ticker, i ->
  now = System.os_time()

  Situ.Connector.deliver_messages(connector, [
    %Situ.Message{data: i, originating_time: now, creation_time: now}
  ])

  Process.sleep(33)
  ticker.(ticker, i + 1)
end

Task.start_link(fn -> ticker.(ticker, 0) end)

# A camera of 640 x 480 with thirty images per second.
shades = for i <- 0..29, do: Situ.Image.new_filled(640, 480, :rgb24, [i * 8, 255 - i * 8, 90])
shades = List.to_tuple(shades)

{:ok, camera} =
  Situ.Pipeline.start(
    fn p ->
      p
      |> Situ.from_enumerable(0..9_999_999, every: 33_333_333, name: "Tick")
      |> Situ.map(&elem(shades, rem(&1, 30)), name: "Image", type: Situ.Image)
    end,
    pipeline: [name: "Camera", replay: [speed: 1.0]]
  )

# A pipeline that ends while a file of the tests exists, and is restarted when it is removed.
brief = fn ->
  {:ok, pid} =
    Situ.Pipeline.start(
      fn p ->
        p
        |> Situ.timer(every: Situ.Time.ms(40), name: "Ticks")
        |> Situ.map(fn _ -> :rand.uniform() end, name: "Brief.Level", type: :float)
      end,
      pipeline: [name: "Brief"]
    )

  pid
end

stop = Path.join(work, "stop")
{:ok, running} = Agent.start_link(brief)

Task.start_link(fn ->
  for _ <- Stream.repeatedly(fn -> Process.sleep(50) end) do
    case {Agent.get(running, & &1), File.exists?(stop)} do
      {pid, true} when is_pid(pid) ->
        Agent.update(running, fn _ -> nil end)
        Situ.Pipeline.stop(pid)

      {nil, false} ->
        Agent.update(running, fn _ -> brief.() end)

      _ ->
        :ok
    end
  end
end)

# A pipeline with composites, a slow part and a lossy connection, for its graph page.
{:ok, factory} =
  Situ.Pipeline.start(
    fn p ->
      belt =
        Situ.composite(p, "Belt", fn p ->
          p
          |> Situ.from_enumerable(0..9_999_999, every: Situ.Time.ms(10), name: "Source")
          |> Situ.map(&(&1 * 2), name: "Double", async: true)
        end)

      slow =
        Situ.composite(belt, "Slow", fn belt ->
          wait = fn n -> Process.sleep(15) && n end
          Situ.map(belt, wait, name: "Heavy", policy: Situ.Delivery.latest())
        end)

      fast = Situ.map(belt, &:math.sin(&1 / 50), name: "Fast", async: true)
      nearest = Situ.Reproducible.nearest(Situ.Time.ms(50))
      slow |> Situ.join(fast, nearest, name: "Join") |> Situ.each(fn _ -> :ok end, name: "Screen")
    end,
    pipeline: [name: "Factory", replay: [speed: 1.0]]
  )

# A pipeline whose source waits for a slow sink.
{:ok, mill} =
  Situ.Pipeline.start(
    fn p ->
      p
      |> Situ.from_enumerable(0..9_999_999, every: Situ.Time.ms(2), name: "Grain")
      |> Situ.each(fn _ -> Process.sleep(12) end,
        name: "Stones",
        async: true,
        policy: Situ.Delivery.throttle(8)
      )
    end,
    pipeline: [name: "Mill", replay: [speed: 1.0]]
  )

# A minute of its diagnostics: a hundred messages per second on the first connection.
log = History.new(seconds: 3_600, live: false)
seen = Situ.Pipeline.info(factory)

for i <- 1..60 do
  edges = Enum.map(seen.edges, &%{&1 | emitted: i * 100, processed: i * 100, busy: i * 1_000_000})
  Fixture.put(log, "Diagnostics", Fixture.t0() + i * 1_000_000_000, 0, %{seen | edges: edges}, i)
end

sources = Map.put(sources, "factory-log", Recordings.History.wrap(log))
layouts = Path.join(work, "layouts")
plugins = PluginFixture.folder(work)

{:ok, main} =
  Situ.Studio.start_link(
    port: 0,
    path: folder,
    sources: sources,
    pipelines: [pipeline, factory, mill, {"Brief", fn -> Agent.get(running, & &1) end}, camera],
    plugins: [plugins],
    layouts: layouts
  )

# A studio with tiles for its maps.
{:ok, mapped} =
  Situ.Studio.start_link(
    id: "mapped",
    port: 0,
    sources: Map.take(sources, ["walk"]),
    layouts: layouts,
    tiles: MapFixture.tiles(work),
    tiles_credit: "(c) the test"
  )

{:ok, guarded} =
  Situ.Studio.start_link(
    id: "guarded",
    port: 0,
    sources: sources,
    layouts: layouts,
    read_only: true,
    token: "the-very-secret-token"
  )

# A study whose sessions are annotated.
studied_folder = Path.join(work, "studied")
SessionFixture.create(studied_folder, folder)

{:ok, studied} =
  Situ.Studio.start_link(id: "studied", port: 0, path: studied_folder, layouts: layouts)

# A study with an experiment.
tuned_folder = Path.join(work, "tuned")
ExperimentFixture.create(tuned_folder)
{:ok, tuned} = Situ.Studio.start_link(id: "tuned", port: 0, path: tuned_folder, layouts: layouts)

# Films with numbered images.
{:ok, filmed} =
  Situ.Studio.start_link(
    id: "filmed",
    port: 0,
    path: VideoFixture.create(Path.join(work, "films")),
    layouts: layouts
  )

# A studio that some users may change and others may only view.
{:ok, shared} =
  Situ.Studio.start_link(
    id: "shared",
    port: 0,
    path: folder,
    layouts: layouts,
    token: "the-token-of-owners",
    viewer_token: "the-token-of-viewers"
  )

# A studio that a proxy serves under a path, with TLS terminated by the proxy. The test starts the
# proxy.
{:ok, taken} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
{:ok, proxy_port} = :inet.port(taken)
:gen_tcp.close(taken)

{:ok, behind} =
  Situ.Studio.start_link(
    id: "behind",
    port: 0,
    path: folder,
    pipelines: [factory],
    layouts: layouts,
    token: "the-very-secret-token",
    public: "https://localhost:#{proxy_port}/lab/studio"
  )

# A studio of an empty folder, and a server of recordings that it can connect to.
{:ok, _} = Application.ensure_all_started(:situ_link)
:ok = Application.load(:situ_examples)
begun = Path.join([work, "start", "recordings"])
File.mkdir_p!(begun)
{:ok, start} = Situ.Studio.start_link(id: "start", port: 0, path: begun, layouts: layouts)
served = %{"hall" => Path.join(folder, "minute.0000")}
{:ok, linked} = Situ.Link.serve(served, port: 0, token: "the-token-of-the-link")

# Two pipelines whose sensor is a page. The second one accepts no images.
sensed = Path.join(work, "sensor.json")
SensorFixture.start(sensed)
worn = Path.join(work, "headset.json")
HeadsetFixture.start(worn)

# A studio that is stopped while a file of the tests exists, and is restarted at the same address.
{:ok, mortal} = Situ.Studio.start_link(id: "mortal", port: 0, path: folder, layouts: layouts)
mortal_port = Situ.Studio.port(mortal)
signal = Path.join(work, "away")

wait = fn there? ->
  Stream.repeatedly(fn -> Process.sleep(20) end)
  |> Enum.find(fn _ -> File.exists?(signal) == there? end)
end

restart = fn restart, mortal ->
  wait.(true)
  Supervisor.stop(mortal)
  wait.(false)
  opts = [id: "mortal", port: mortal_port, path: folder, layouts: layouts]
  {:ok, mortal} = Situ.Studio.start_link(opts)
  restart.(restart, mortal)
end

# Recordings of the demo, for the images of the guide.
shown = Path.join(work, "shown")

{:ok, demo} =
  Situ.Studio.start_link(id: "demo", port: 0, path: shown, pipelines: [factory], layouts: layouts)

base = &(&1 |> Situ.Studio.url() |> String.trim_trailing("/"))

IO.puts(
  "ready " <>
    Situ.JSON.encode(%{
      "main" => base.(main),
      "mapped" => base.(mapped),
      "start" => base.(start),
      "linked" => "situ://127.0.0.1:#{Situ.Link.Server.port(linked)}",
      "studied" => base.(studied),
      "tuned" => base.(tuned),
      "video" => base.(filmed),
      "studied_folder" => studied_folder,
      "guarded" => Situ.Studio.url(guarded),
      "mortal" => base.(mortal),
      "shared" => Situ.Studio.url(shared),
      "viewed" => Situ.Studio.viewer_url(shared),
      "behind" => Situ.Studio.url(behind),
      "behind_port" => Situ.Studio.port(behind),
      "away" => signal,
      "demo" => base.(demo),
      "shown" => shown,
      "sensor" => sensed,
      "headset" => worn,
      "folder" => folder,
      "random" => random,
      "windows" => windows,
      "zoo" => Path.join(work, "zoo.json"),
      "dense" => Path.join(work, "dense.json"),
      "stop" => Path.join(work, "stop"),
      "points" => points,
      "t0" => Integer.to_string(Fixture.t0())
    })
)

restart.(restart, mortal)
