defmodule Situ.Livebook.RenderTest do
  # The outputs of values, as Livebook receives them, with the stock test helpers of Kino.
  use ExUnit.Case, async: false
  import Kino.Test
  alias Situ.{AudioBuffer, AudioFormat, Image, Pipeline, PointCloud}

  @moduletag :capture_log
  setup :configure_livebook_bridge
  doctest Situ.Livebook

  defp sine(p) do
    count = Situ.sequence(p, 0, &(&1 + 1), every: Situ.Time.ms(2), name: "Count")
    Situ.map(count, &:math.sin(&1 / 20), name: "Sine")
  end

  # The text of a Kino.JS output, such as HTML or a Mermaid diagram.
  defp js_data(%{type: :js, js_view: %{ref: ref, pid: pid}}) do
    send(pid, {:connect, self(), %{origin: "test", ref: ref}})
    assert_receive {:connect_reply, data, %{ref: ^ref}}, 5_000
    data
  end

  defp render(value), do: Kino.Render.to_livebook(value)

  defp frame_output(ref, matches?) do
    assert_receive {:livebook_put_output,
                    %{type: :frame_update, ref: ^ref, update: {:replace, [output]}}},
                   10_000

    if matches?.(output), do: output, else: frame_output(ref, matches?)
  end

  test "images, audio, clouds and messages" do
    {:ok, image} = Image.new(width: 8, height: 8, format: :gray8, data: :binary.copy(<<90>>, 64))

    assert %{type: :image, content: <<0xFF, 0xD8, _::binary>>, mime_type: "image/jpeg"} =
             render(image)

    audio = AudioBuffer.from_samples([0, 16384, -16384, 0], AudioFormat.pcm(16_000))
    assert %{type: :grid, outputs: [%{type: :js}, waveform]} = render(audio)
    assert js_data(waveform) =~ "4 frames"

    cloud = PointCloud.from_points([{0.0, 0.0, 0.0}, {2.0, 4.0, 6.0}])
    assert js_data(render(cloud)) =~ "<svg"

    message = %Situ.Message{data: image, originating_time: 0}
    assert %{type: :grid, outputs: [%{text: time}, %{type: :image}]} = render(message)
    assert time =~ "1970-01-01"
  end

  @tag :tmp_dir
  test "a report is its graph, and a recording is its timeline", %{tmp_dir: dir} do
    {:ok, report} =
      Pipeline.run(
        fn p ->
          store = Situ.Store.create(p, "lab", dir)
          p |> Situ.from_enumerable([1.0, 2.5], every: 10) |> Situ.Store.write(store, "Level")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    assert %{type: :tabs, outputs: [graph, _inspected]} = render(report)
    assert js_data(graph).diagram =~ "graph LR"
    {:ok, recording} = Situ.Store.open(Path.join(dir, "lab"))
    assert js_data(render(recording)) =~ "Level"
  end

  test "streams and graphs of a running pipeline are drawn again and again" do
    {:ok, pipeline} = Pipeline.start(&sine/1)
    on_exit(fn -> Pipeline.stop(pipeline) end)
    %{ref: ref} = Situ.Livebook.show({pipeline, "Sine"}, every: 10)
    first = frame_output(ref, &(&1.type == :js)) |> js_data()
    assert first =~ "<svg"
    assert frame_output(ref, &(&1.type == :js)) |> js_data() != first

    %{ref: ref} = Situ.Livebook.graph(pipeline, every: 10)
    assert frame_output(ref, &(&1.type == :js)) |> js_data() |> Map.fetch!(:diagram) =~ "Sine"

    %{ref: ref} = Situ.Livebook.show({pipeline, "Nothing"})
    assert frame_output(ref, &(&1.type == :plain_text)).text =~ "Nothing"
  end

  test "buttons start and stop a pipeline" do
    %{type: :grid, outputs: [buttons, frame]} =
      (&sine/1) |> Situ.Livebook.run(show: ["Sine"], pipeline: [name: "Buttons"]) |> render()

    assert %{outputs: [start, stop]} = buttons
    press = &send(&1.destination, {:event, &1.ref, %{origin: "test", type: :click}})
    assert Enum.filter(Pipeline.list(), &(&1.name == "Buttons")) == []
    press.(start)
    frame_output(frame.ref, &(&1.type == :grid))
    assert [%{pid: pid}] = Enum.filter(Pipeline.list(), &(&1.name == "Buttons"))
    monitor = Process.monitor(pid)
    press.(stop)
    assert_receive {:DOWN, ^monitor, _, _, _}, 20_000
  end

  describe "smart cells" do
    test "the recording cell writes the code that opens a recording" do
      {kino, source} = start_smart_cell!(Situ.Livebook.RecordingCell, %{"variable" => "walk"})
      assert source == ~s|{:ok, walk} = Situ.Store.open("recordings/first")\nwalk|
      push_event(kino, "update", %{"field" => "path", "value" => "my \"walk\""})

      assert_smart_cell_update(
        kino,
        %{"path" => "my \"walk\""},
        ~S|{:ok, walk} = Situ.Store.open("my \"walk\"")| <> "\nwalk"
      )

      push_event(kino, "update", %{"field" => "variable", "value" => "System.halt"})
      assert_broadcast_event(kino, "update", %{"field" => "variable", "value" => "walk"})
    end

    test "the pipeline cell writes the code that runs a pipeline" do
      {kino, source} =
        start_smart_cell!(Situ.Livebook.PipelineCell, %{
          "source" => "Situ.return(p, 1, name: \"One\")",
          "show" => "One"
        })

      assert source ==
               "Situ.Livebook.run(\n  fn p ->\n    Situ.return(p, 1, name: \"One\")\n  end,\n  show: [\"One\"]\n)"

      push_smart_cell_editor_source(kino, "Situ.return(p, ")

      assert_smart_cell_update(
        kino,
        %{"source" => "Situ.return(p, "},
        "Situ.Livebook.run(fn p ->\nSitu.return(p, \nend, show: [\"One\"])"
      )
    end
  end
end
