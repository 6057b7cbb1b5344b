defmodule Situ.Examples.SceneTest do
  use ExUnit.Case, async: true
  alias Situ.Examples.Demo
  alias Situ.Examples.Scene.{Crop, Histogram}
  alias Situ.{PointCloud, Store}
  alias Situ.Studio.Layout
  doctest Crop
  doctest Histogram

  @tag :tmp_dir
  test "a recording of the room has every stream of its layout and correct detections", %{
    tmp_dir: folder
  } do
    assert {:ok, %{result: %{path: path}}} =
             Demo.SceneCommand.record_room(seconds: 4.0, out: folder, fast: true)

    {:ok, store} = Store.open(path)
    names = for s <- Store.streams(store), do: s.name

    {:ok, layout} =
      path
      |> Demo.SceneCommand.write_layout_folder()
      |> Path.join("scene.json")
      |> File.read!()
      |> Layout.Json.parse_json()

    drawn = for panel <- layout.panels, vis <- panel.vis, do: vis.stream
    assert Enum.uniq(drawn) -- names == []

    clouds = store |> Store.messages("Room.Cloud") |> Enum.to_list()
    assert length(clouds) == 60

    assert Enum.all?(
             clouds,
             &(PointCloud.point_count(&1.data) == 320 * 240 and &1.data.colors != nil)
           )

    # The clip contains speech from 0.76 s to 3.6 s: one interval, within the error of a detector.
    start = hd(clouds).originating_time

    assert [%{data: {speech, "person 0"}} | _] =
             store |> Store.messages("Room.Speech") |> Enum.to_list()

    assert_in_delta (speech.left - start) / 1.0e9, 0.76, 0.4

    # The walking person is within the cropped image; people outside it are not drawn on it.
    for %{data: found} <- store |> Store.messages("Room.Detections") |> Enum.take(5) do
      assert [{%{id: 0, score: score} = rect, joints} | others] = found
      assert Enum.all?(others, fn {other, _} -> other.x + other.width / 2 >= 0 end)
      assert score > 0.8 and length(joints) > 11
      assert rect.x >= 0 and rect.y > -20
    end

    %{data: heights} = store |> Store.messages("Room.Heights") |> Enum.at(0)
    assert heights |> Enum.map(&elem(&1, 1)) |> Enum.sum() == div(320 * 240, 5)
  end

  test "reports unknown arguments" do
    assert ExUnit.CaptureIO.capture_io(:stderr, fn ->
             assert Demo.run(["--scene", "--quickly"]) == 2
           end) =~ "--quickly"

    assert ExUnit.CaptureIO.capture_io(fn -> assert Demo.run(["--scene", "--help"]) == 0 end) =~
             "Usage: bin/demo --scene"
  end
end
