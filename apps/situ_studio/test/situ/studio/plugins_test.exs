defmodule Situ.Studio.PluginsTest do
  # Not async, because it compiles modules into this VM and registers readers and tasks.
  use ExUnit.Case, async: false

  alias Situ.Studio.{
    Asking,
    DataSession,
    GuidePlugin,
    History,
    Plugins,
    Recordings,
    StreamOverview
  }

  @moduletag :tmp_dir

  # The next test loads the guide's module from another folder.
  setup do
    on_exit(fn ->
      :code.purge(Gaze.Angles)
      :code.delete(Gaze.Angles)
    end)
  end

  defp manifest(parts, id \\ "odd"),
    do: Situ.JSON.encode(%{"plugin" => 1, "id" => id, "parts" => parts})

  defp part(more),
    do:
      Map.merge(
        %{
          "kind" => "visualizer",
          "id" => "v",
          "types" => ["signal"],
          "panel" => "own",
          "script" => "web/v.js"
        },
        more
      )

  defp plugin(folder, files) do
    for {path, text} <- files do
      File.mkdir_p!(Path.dirname(Path.join(folder, path)))
      File.write!(Path.join(folder, path), text)
    end

    Plugins.plugin(folder)
  end

  test "loads the guide's visualizer, adapter and script", %{tmp_dir: dir} do
    folder = Path.join(dir, "gaze-heat-map")
    assert length(GuidePlugin.write(folder)) == 5
    assert [plugin] = Plugins.load([dir])
    assert plugin.problem == nil
    assert inspect(plugin.modules) == "[Gaze.Angles]"
    assert [heat] = plugin.visualizers
    assert {heat.id, heat.panel, heat.shapes} == {"gaze-heat-map/heat", :image, [:shapes]}
    assert heat.script == "/plugins/gaze-heat-map/heat.js"
    assert heat.asks == [:seconds]

    ids = for v <- Plugins.list_visualizers([plugin]), do: {v.id, v.shapes}
    assert {"gaze-heat-map/heat", [:shapes]} in ids
    assert {"shapes@gaze-angles", [:signals]} in ids
    # A second load returns the same modules.
    assert Plugins.plugin(folder).modules == plugin.modules
  end

  test "sends the history of a stream as rows, also through the adapter", %{tmp_dir: dir} do
    GuidePlugin.write(dir)
    extra = Plugins.list_visualizers([Plugins.plugin(dir)])
    history = History.new(live: false)

    for i <- 0..20 do
      message = Asking.message(1_000_000_000 * (i + 1), %{"yaw" => 0, "pitch" => i}, i)
      History.put(history, "angles", message, 8)
    end

    session = DataSession.new(Recordings.History.wrap(history), extra)
    props = %{"seconds" => 4.5}
    spec = %{"stream" => "angles", "viz" => "gaze-heat-map/heat@gaze-angles", "props" => props}
    request = %{"open" => [[1, spec]], "instant" => [1], "at" => "11000000000"}
    {%{frames: [frame]}, _} = Asking.ask(session, request)
    assert frame.kind == 5, frame.payload
    %{"rows" => rows, "sampled" => false} = Asking.json(frame.payload)
    assert Enum.map(rows, &hd/1) == [-4000.0, -3000.0, -2000.0, -1000.0, 0.0]
    assert [_, %{"type" => "Situ.Point2", "x" => 160.0, "y" => y}] = List.last(rows)
    assert_in_delta y, 120 - 300 * :math.tan(:math.pi() / 18), 1.0e-9
  end

  test "explains errors in a manifest", %{tmp_dir: dir} do
    for {text, words} <- [
          {"{", "not JSON"},
          {"{}", ~s(must contain "plugin": 1)},
          {~s({"plugin": 2, "id": "a"}), "reads version 1"},
          {manifest([part(%{"panel" => "plot"})]), "other panels need a \"module\""},
          {manifest([part(%{"script" => "../../etc/passwd.js"})]), "below web/"},
          {manifest([part(%{"script" => "web/../../x.js"})]), "below web/"},
          {manifest([part(%{"script" => "https://example.org/x.js"})]), "below web/"},
          {manifest([part(%{"types" => []})]), "\"types\""},
          {manifest([part(%{"options" => %{"A b" => %{"type" => "text"}}})]),
           "lowercase letters"},
          {manifest([part(%{"options" => %{"a" => %{"type" => "range"}}})]), "needs \"min\""},
          {manifest([part(%{"kind" => "spell"})]), "\"kind\""},
          {manifest([part(%{})]), "the script web/v.js does not exist"},
          {manifest([part(%{"module" => "Nobody.Here"})]), "names Nobody.Here"}
        ] do
      assert %{problem: problem} = plugin(dir, [{"plugin.json", text}])
      assert problem =~ words, "#{text}: #{problem}"
    end
  end

  test "code that does not compile leaves visualizers that show the reason", %{tmp_dir: dir} do
    files = [{"plugin.json", manifest([part(%{})])}, {"web/v.js", ""}]

    for {code, words} <- [
          {"defmodule Odd.A do", "missing terminator"},
          {"defmodule Odd.B do\n  def f, do: g()\nend", "undefined function g/0"},
          {"defmodule Situ.Studio.Draw do\nend", "which already exists"},
          {"exit(:no)", "failed while it was loaded"}
        ] do
      assert %{problem: problem, visualizers: [v]} = plugin(dir, [{"lib/a.ex", code} | files])
      assert problem =~ words
      assert v.module == Situ.Studio.Visualizers.BrokenPlugin
      session = %{Asking.session() | visualizers: [v]}
      spec = %{"stream" => "level", "viz" => "odd/v"}

      {%{frames: frames}, _} =
        Asking.ask(session, %{"open" => [[1, spec]], "instant" => [1], "at" => "1500000000"})

      assert [%{kind: 8, payload: text}] = frames
      assert text =~ "the plug-in odd is broken" and text =~ words
    end
  end

  test "reports the second plug-in with the same id, and ignores other folders", %{
    tmp_dir: dir
  } do
    for name <- ["a", "b"] do
      plugin(Path.join(dir, name), [{"plugin.json", manifest([], "same")}])
    end

    File.mkdir_p!(Path.join(dir, "empty"))
    assert [%{problem: nil}, %{problem: problem}] = Plugins.load([dir])
    assert problem =~ "another plug-in has the same id, same"
  end

  test "a failing visualizer disables only its own channel", %{tmp_dir: dir} do
    code = """
    defmodule Odd.Wild do
      @behaviour Situ.Studio.Visualizer
      @impl true
      def about, do: %Situ.Studio.Visualizer{id: "wild", title: "Wild", panel: :own, shapes: :any}
      @impl true
      def instant(_channel, data, _message) when data < 100, do: raise("not my day")
      def instant(_channel, data, _message) when data < 200, do: exit(:gone)
      def instant(_channel, _data, _message), do: [:no_bytes]
    end
    """

    plugin = plugin(dir, [{"plugin.json", manifest([])}, {"lib/wild.ex", code}])
    session = DataSession.new(Asking.session().source, Plugins.list_visualizers([plugin]))
    wild = %{"stream" => "level", "viz" => "wild"}
    fine = %{"stream" => "level", "viz" => "value"}

    for {at, words} <- [
          {"1050000000", "not my day"},
          {"1150000000", "it ended: :gone"},
          {"1250000000", "the plug-in odd:"}
        ] do
      request = %{"open" => [[1, wild], [2, fine]], "instant" => [1, 2], "at" => at}
      {%{frames: [broken, good]}, _} = Asking.ask(session, request)
      assert broken.kind == 8 and broken.payload =~ words
      assert good.kind == 5
    end
  end

  test "registers a plug-in's readers and tasks with stores and datasets", %{tmp_dir: dir} do
    code = """
    defmodule Odd.Task do
      @behaviour Situ.Dataset.Task
      @impl true
      def task, do: %{name: "odd-task", about: "does nothing", output: nil, options: []}
      @impl true
      def build(_p, _opts), do: :ok
    end
    """

    before = Application.get_env(:situ_dataset, :dataset_tasks)
    on_exit(fn -> Application.put_env(:situ_dataset, :dataset_tasks, before) end)
    plugin = plugin(dir, [{"plugin.json", manifest([])}, {"lib/task.ex", code}])
    assert Plugins.register_modules([plugin]) == :ok
    assert {:ok, module} = Situ.Dataset.Task.fetch_task("odd-task")
    assert inspect(module) == "Odd.Task"
  end

  test "the template writes a complete plug-in", %{tmp_dir: dir} do
    assert {:ok, folder, files} = Plugins.Template.write("my-lamp", dir)
    assert "plugin.json" in files
    assert %{problem: nil, visualizers: [%{id: "my-lamp/recent"}]} = Plugins.plugin(folder)
    assert {:error, %{code: :exists}} = Plugins.Template.write("my-lamp", dir)
  end

  test "an adapter turns any data into signals, over time and at the cursor" do
    defmodule Tenth do
      @behaviour Situ.Studio.Adapter
      @impl true
      def about,
        do: %Situ.Studio.Adapter{id: "tenth", title: "tenth", from: [:signal], to: :signal}

      @impl true
      def adapt(x, _) when x < 500, do: {:ok, x / 10}
      def adapt(_, _), do: :error
    end

    extra = Plugins.list_visualizers([], [], [Tenth])
    source = Asking.session().source
    session = DataSession.new(source, extra)
    spec = %{"stream" => "level", "viz" => "line@tenth"}
    series = [[1, "1000000000", "1009000000", 1_000_000]]
    {%{frames: [frame]}, _} = Asking.ask(session, %{"open" => [[1, spec]], "series" => series})
    assert frame.kind == 1

    assert {:ok, points, true} =
             StreamOverview.read_series(
               Recordings.Adapted.wrap(source, Tenth),
               "level",
               1_498_000_000,
               1_501_000_000,
               1_000
             )

    near = Enum.filter(points, &(elem(&1, 0) in 1_497_000_000..1_502_000_000))
    assert Enum.map(near, &elem(&1, 3)) == [49.7, 49.8, 49.9, nil, nil, nil]
  end
end
