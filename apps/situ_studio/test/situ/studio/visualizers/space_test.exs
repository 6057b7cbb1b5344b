defmodule Situ.Studio.Visualizers.SpaceTest do
  use ExUnit.Case, async: true

  alias Situ.{Mesh, Message, PointCloud, Pose}
  alias Situ.Studio.{Draw, History, Visualizers, Recordings}
  alias Situ.Studio.Visualizers.Space

  @mesh %Mesh{vertices: :binary.copy(<<0::96>>, 300), indices: :binary.copy(<<0::96>>, 100)}

  defp spec(props \\ %{}) do
    {:ok, viz} = Visualizers.fetch("space", :space)
    %{stream: "S", viz: viz, path: [], props: props}
  end

  defp items(data, context) do
    message = %Situ.Message{originating_time: 5, data: data}
    {:kept, frame, kept} = Space.instant(1, data, message, context)
    bytes = IO.iodata_to_binary(frame)
    {at, _} = :binary.match(bytes, [~s({"items"), ~s({"problems")])
    <<size::little-32>> = binary_part(bytes, at - 8, 4)
    {:ok, %{"items" => items}} = Situ.JSON.decode(binary_part(bytes, at, size))
    {items, byte_size(bytes), kept}
  end

  test "sends a moving mesh once, and its position each time" do
    context = &%{source: nil, spec: spec(), kept: &1}
    {[first], whole, kept} = items(@mesh, context.(%{}))
    assert %{"keep" => name, "at" => %{"position" => [_, 3600]}} = first

    moved = Mesh.transform(@mesh, Pose.new({1.0, 2.0, 3.0}))
    {[again], less, ^kept} = items(moved, context.(kept))
    assert %{"held" => ^name, "at" => at, "count" => 100} = again
    assert at == %{} and Enum.slice(again["matrix"], 12, 3) == [1.0, 2.0, 3.0]
    assert less < whole - 4_000

    other = %{@mesh | indices: :binary.copy(<<1::little-96>>, 100)}
    {[%{"keep" => another}], _, kept} = items(other, context.(kept))
    assert another != name and map_size(kept) == 2
  end

  test "a channel remembers the sent meshes, also after a gap" do
    history = History.new(live: false)

    for {time, pose} <- [{5, Pose.identity()}, {9, Pose.new({1.0, 0.0, 0.0})}] do
      message = %Message{
        data: Mesh.transform(@mesh, pose),
        originating_time: time,
        sequence_id: time
      }

      History.put(history, "S", message, 8)
    end

    at = fn time, last ->
      {frame, last} = Draw.draw_instant(Recordings.History.wrap(history), 1, spec(), time, last)
      {IO.iodata_to_binary(frame), last}
    end

    {first, last} = at.(5, nil)
    {same, last} = at.(6, last)
    {nothing, last} = at.(4, last)
    {second, last} = at.(9, last)
    {whole, _} = at.(9, nil)
    assert first =~ ~s("keep") and second =~ ~s("held") and whole =~ ~s("keep")
    assert byte_size(second) < byte_size(first) - 4_000
    assert max(byte_size(same), byte_size(nothing)) < 100
    {again, _} = at.(5, last)
    assert again =~ ~s("held")
  end

  test "sends the entire mesh if the page has no room to keep it" do
    full = %{"other" => 67_108_864}
    assert {[item], _, ^full} = items(@mesh, %{source: nil, spec: spec(), kept: full})
    refute Map.has_key?(item, "keep") or Map.has_key?(item, "held")
  end

  test "sends only the visible part of a large cloud" do
    cloud = PointCloud.from_points(for x <- 1..300_000, do: {x / 1000, 0.0, 0.0})
    data = %{cloud: cloud, mesh: @mesh}

    {[rough, _mesh], _, _} =
      items(data, %{source: nil, spec: spec(%{"budget" => "100000"}), kept: %{}})

    assert %{"count" => 100_000, "of" => 300_000} = rough

    # The planes select 1 m to 2 m.
    planes = [1, 0, 0, -1.0005, -1, 0, 0, 2.0005]
    props = %{"budget" => "100000", "within" => planes}
    assert {[near], _, _} = items(data, %{source: nil, spec: spec(props), kept: %{}})
    assert %{"kind" => "points", "count" => 1_000, "of" => 1_000} = near

    # Invalid planes are ignored.
    for bad <- [[1, 2, 3], ["x", 0, 0, 0], "all", List.duplicate(0, 400), [1.0e300, 0, 0, 0]] do
      props = %{"budget" => "100000", "within" => bad}
      {items, _, _} = items(data, %{source: nil, spec: spec(props), kept: %{}})
      assert length(items) == 2
    end
  end
end
