# Starts studios with what the guides make, and prints their addresses as JSON. Ends with its standard input.
# `test/docs/pictures` takes the pictures.
Code.require_file("../../apps/situ_infer/test/support/chat_server.ex", __DIR__)
Code.require_file("../../apps/situ_studio/test/support/guide_plugin.ex", __DIR__)
Code.require_file("../browser/fixture.exs", __DIR__)
Code.require_file("../browser/plugin_fixture.exs", __DIR__)
guides = Path.expand("../../docs/guides", __DIR__)

# Returns the code blocks of a guide that contain a text.
blocks = fn guide, text ->
  for [_, code] <- Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(Path.join(guides, guide))),
      code =~ text,
      do: code
end

Code.compile_string(hd(blocks.("writing-a-component.md", "defmodule Turns")))
Code.compile_string(hd(blocks.("live-views.md", "defmodule Guide.Counter")))
[hall | _] = blocks.("from-one-machine-to-ten.md", "defmodule Guide.Hall")
hall |> String.split("rules =") |> hd() |> Code.compile_string()
Code.require_file("scenes.exs", __DIR__)
Code.require_file("annotation_scene.exs", __DIR__)

for app <- [
      :situ_studio,
      :situ_examples,
      :situ_cluster,
      :situ_link,
      :situ_bridge,
      :situ_infer,
      :situ_assistant
    ],
    do: {:ok, _} = Application.ensure_all_started(app)

[folder] = System.argv()
alias Situ.Infer.Test.ChatServer
alias Situ.Studio.Recordings

Scenes.walk(folder)
Scenes.operators(folder)
Scenes.colours(folder)
python = System.get_env("SITU_TEST_PYTHON") || "python3"
Scenes.python(folder, Path.join(guides, "python-components.md"), python)

answers = %{
  "What time is it?" => ["It is ", "ten past ", "three."],
  "Thank you." => ["You are ", "welcome."]
}

chat =
  ChatServer.start(fn %{body: %{"messages" => turns}}, _n ->
    ChatServer.stream(Map.get(answers, List.last(turns)["content"], ["Rembrandt, ", "in 1642."]))
  end)

Scenes.chat(folder, chat.url)
File.cp!(Situ.Examples.Demo.Options.default_clip(), Path.join(folder, "talk1.mp4"))
bag = Path.expand("../../apps/situ_bridge/test/data/ros1_imu_gps_cam.bag", __DIR__)
File.cp!(bag, Path.join(folder, "drive.bag"))
AnnotationScene.create(folder)

pipelines =
  for {name, build} <- Scenes.pipelines() do
    {:ok, pipeline} = Situ.Pipeline.start(build, pipeline: [name: name])
    {name, pipeline}
  end

plugins = Path.join(folder, "plugins")
Situ.Studio.GuidePlugin.write(Path.join(plugins, "gaze-heat-map"))

{:ok, main} =
  Situ.Studio.start_link(
    port: 0,
    path: folder,
    pipelines: pipelines,
    sources: %{"gaze" => Recordings.History.wrap(PluginFixture.gaze())},
    plugins: [plugins],
    id: "pictures"
  )

# The recordings of this machine, as another one sees them.
served = Map.new(["walk", "detector"], &{&1, Path.join(folder, &1 <> ".0000")})
{:ok, server} = Situ.Link.serve(served, port: 0)

{:ok, linked} =
  Situ.Studio.start_link(
    port: 0,
    path: "situ://127.0.0.1:#{Situ.Link.Server.port(server)}",
    id: "linked"
  )

{:ok, guarded} =
  Situ.Studio.start_link(port: 0, path: folder, id: "guarded", token: "a-long-secret")

# The view of the guide, with the script of the studio, which starts the same clients.
defmodule Scenes.Page do
  use Situ.Live.Component

  def layout(assigns) do
    ~H"""
    <html lang="en">
      <head>
        <meta charset="utf-8"><title>{@page_title}</title><base href="/">
        <link rel="stylesheet" href="assets/studio.css"><script defer src="assets/studio.js"></script>
      </head>
      <body><main class="message">{@inner_content}</main></body>
    </html>
    """
  end
end

{:ok, counter} =
  Situ.Live.start_link(
    port: 0,
    layout: &Scenes.Page.layout/1,
    routes: [{:live, "/", Guide.Counter}, {:static, "/assets", {:situ_studio, "priv/static"}}]
  )

# A cluster of one node that runs the guide's pipeline in three parts.
{:ok, _} = Situ.Cluster.join(log: Path.join(folder, "log"), labels: ["sensor", "compute"])

{:ok, _hall} =
  Situ.Cluster.deploy(Guide.Hall,
    opts: [count: 10_000_000],
    place: [{"Smooth", on: "compute", deterministic: true}, {:rest, on: "sensor"}],
    publish: ["Mean"],
    checkpoint: Situ.Time.s(1),
    pipeline: [replay: [interval: {0, Situ.Time.h(10)}, speed: 1.0]]
  )

# The race of the guide about simulations: its first two blocks define it, and the third one finds it.
[race | _] = blocks.("simulation.md", "defmodule Guide.Calibrate")
[check | _] = blocks.("simulation.md", "failure =")

{failure, _} =
  Code.eval_string(race <> "\n" <> String.replace(check, "{failure.kind", "failure\n#"))

# The experiment of the guide, over ten sessions.
[tune | _] = blocks.("experiments.md", "use Situ.Experiment")
[{tune, _}] = Code.compile_string(tune)
demo = Application.app_dir(:situ_examples, "priv/demo")

clips =
  for name <- ~w(talk2 talk3),
      do: {Path.join(demo, name <> ".mp4"), Path.join(demo, name <> ".truth.json")}

{:ok, dataset} = Situ.Examples.ClipVariants.create_dataset(clips, Path.join(folder, "experiment"))
{:ok, {results, run}} = Situ.Experiment.Runner.run(tune, dataset, jobs: 2)
{:ok, _} = Situ.Experiment.Baseline.promote_set(results, run, 2)
comment = "Takes the noise for a voice. Try a higher threshold?"
:ok = Situ.Experiment.Comments.add_comment(results, {run["run"], 7}, comment, "reviewer")

# What a notebook shows of a recording.
code = "import situ, sys; print(situ.open(sys.argv[1])._repr_html_())"
client = Path.expand("../../clients/python/src", __DIR__)

{notebook, 0} =
  System.cmd(python, ["-c", code, "operators.0000"], cd: folder, env: [{"PYTHONPATH", client}])

addresses = %{
  notebook: notebook,
  main: Situ.Studio.url(main),
  linked: Situ.Studio.url(linked),
  guarded: "http://localhost:#{Situ.Studio.port(guarded)}/",
  counter: Situ.Live.url(counter),
  failure: Exception.message(failure)
}

IO.puts("ready " <> Situ.JSON.encode(addresses))
IO.read(:stdio, :line)
