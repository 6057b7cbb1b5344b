defmodule Situ.Studio.Visualizers.MasksTest do
  # Draws masks with their boxes, from one stream or from two.
  use ExUnit.Case, async: true
  doctest Situ.Studio.Visualizers.Masks

  alias Situ.{Image, Message, Rect}
  alias Situ.Studio.{Draw, Frame, History, StreamInfo, Visualizers, Recordings}

  @mask Image.new_filled(2, 2, :gray8, [255])
  @rect %Rect{x: 1, y: 2, width: 3, height: 4, label: "cup", score: 0.5, id: 7}

  defp source(streams) do
    history = History.new(live: false)

    for {name, time, data} <- streams,
        do: History.put(history, name, %Message{data: data, originating_time: time}, 8)

    Recordings.History.wrap(history)
  end

  defp drawn(source, stream, time) do
    {:ok, viz} = Visualizers.fetch_by_id("masks", [])

    {frame, _} =
      Draw.draw_instant(source, 0, %{stream: stream, viz: viz, path: [], props: %{}}, time, nil)

    IO.iodata_to_binary(frame)
  end

  defp holds?(frame, text), do: :binary.match(frame, text) != :nomatch

  test "takes the boxes from the stream with as many at that time" do
    source =
      source([
        {"Find.Masks", 5, [@mask]},
        {"Find.Boxes", 5, [@rect]},
        {"Faces", 5, [@rect, @rect]},
        {"Find.Late", 6, [%{@rect | label: "late"}]}
      ])

    frame = drawn(source, "Find.Masks", 9)
    assert holds?(frame, ~s("box":[1,2,3,4]))
    assert holds?(frame, ~s("label":"cup"))
    assert holds?(frame, ~s("runs":[255,4]))
  end

  test "draws pairs of box and mask, and reports masks without boxes" do
    frame = drawn(source([{"Pairs", 5, [{@rect, @mask}]}]), "Pairs", 9)
    assert holds?(frame, ~s("box":[1,2,3,4]))
    frame = drawn(source([{"Alone", 5, [@mask]}]), "Alone", 9)

    assert frame ==
             IO.iodata_to_binary(
               Frame.error(0, "no stream has as many rectangles at the same time")
             )
  end

  test "returns an error for data that is not a mask" do
    for data <- [Image.new_filled(2, 2, :rgb24), "text", %{@mask | data: <<1>>}] do
      frame = drawn(source([{"S", 5, data}]), "S", 9)
      refute holds?(frame, "runs")
    end
  end

  test "recognizes streams of masks by type and by data" do
    assert StreamInfo.shape_of_type({:list, Situ.Image}) == :masks
    assert StreamInfo.shape_of([{@rect, @mask}]) == :masks
    assert Enum.any?(Visualizers.for_shape(:image), &(&1.id == "masks"))
    assert hd(Visualizers.for_shape(:masks)).id == "masks"
  end
end
