defmodule Situ.Studio.HeadsetTest do
  # A page of this test sends moments over a real WebSocket, and acknowledges drawings one by one.
  use ExUnit.Case, async: true
  alias Situ.{Box3, JSON, Pose}
  alias Situ.Studio.Headset
  alias Situ.Studio.Headset.{Display, Packet}
  alias Situ.Studio.Sensor.Inbox
  alias Situ.Studio.Test.SensorPage, as: Page

  @moduletag :capture_log

  setup do
    name = "headset-#{System.unique_integer([:positive])}"
    {:ok, studio} = Situ.Studio.start_link(port: 0, id: name)
    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start(fn p ->
        headset = Headset.open(p, page: name)
        for {output, stream} <- headset, do: Situ.each(stream, &send(me, {output, &1}))

        headset.select
        |> Situ.map(fn %{left: left} -> if left, do: {"pinched", box()}, else: [] end, type: :any)
        |> Display.show(page: name, as: "said")
      end)

    on_exit(fn -> Situ.Pipeline.stop(pipeline, timeout: 1_000) end)
    Page.poll(fn -> Inbox.fetch_sensor(Headset, name) != :error end)
    %{port: Situ.Studio.port(studio), name: name}
  end

  defp box, do: Box3.new!({1.0, -0.1, 1.0}, {1.2, 0.1, 1.2})

  defp connect(context), do: Page.connect(context.port, "/headset/socket?name=#{context.name}")

  defp row({x, y, z}, {i, j, k, w} \\ {0.0, 0.0, 0.0, 1.0}),
    do: for(v <- [x, y, z, i, j, k, w], into: <<>>, do: <<v::little-float-32>>)

  defp moment(flags, rows, planes \\ ""),
    do: IO.iodata_to_binary([<<4, flags, 0::48, Page.now_ms()::little-float-64>>, rows, planes])

  # Returns joints in a row that leads away from the wearer.
  defp hand, do: for(i <- 0..24, do: row({0.1, 1.0, -i / 100}))

  test "receives head, hands, gaze, selections and planes", context do
    {"HTTP/1.1 101" <> _, socket} = connect(context)
    assert Page.json(socket) == %{"credit" => 4}
    Page.text(socket, %{offset: 0})
    half = :math.sqrt(0.5)
    floor = %{label: "floor", pose: [0, 0, -2, 0, 0, 0, 1], polygon: [[-1, -3], [1, -3], [1, 3]]}

    # The head is turned a quarter to the left, the gaze points right, and the right hand pinches.
    head = row({0.0, 1.6, -2.0}, {0.0, half, 0.0, half})
    right = row({0.0, 1.6, -2.0}, {0.0, -half, 0.0, half})
    bytes = moment(2 + 4 + 8 + 32 + 64, [head, hand(), right], JSON.encode([floor]))
    Page.push(socket, 2, bytes)

    assert_receive {:head, %Pose{} = pose}
    assert near?(pose.position, {2.0, 0.0, 1.6})
    {ahead, _, up} = Pose.axis_directions(pose)
    assert near?(ahead, {0.0, 1.0, 0.0}) and near?(up, {0.0, 0.0, 1.0})
    assert_receive {:right, skeleton}
    assert map_size(skeleton.joints) == 26 and skeleton.id == :right
    assert Enum.sort(Map.keys(skeleton.joints)) == Enum.sort(Packet.hand_joints())
    assert length(skeleton.bones) == 25
    assert near?(skeleton.joints.wrist.position, {0.0, -0.1, 1.0})
    assert near?(skeleton.joints.pinky_finger_tip.position, {0.24, -0.1, 1.0})
    # The palm is between joints 10 and 11 of the middle finger.
    assert near?(skeleton.joints.palm.position, {0.105, -0.1, 1.0})
    assert_receive {:gaze, ray}
    assert near?(ray.origin, {2.0, 0.0, 1.6}) and near?(ray.direction, {0.0, -1.0, 0.0})
    assert_receive {:select, %{left: false, right: true}}
    assert_receive {:planes, [%{label: "floor", polygon: [first | _], rectangle: rectangle}]}
    assert near?({first.x, first.y, first.z}, {5.0, 1.0, 0.0})
    assert_in_delta rectangle.width, 2.0, 1.0e-6
    assert_in_delta rectangle.height, 6.0, 1.0e-6
    assert near?(rectangle.pose.position, {2.0, 0.0, 0.0})

    assert near?(
             rectangle |> Situ.Rectangle3.containing_plane() |> Map.fetch!(:normal),
             {0.0, 0.0, 1.0}
           )

    corners = Situ.Rectangle3.corner_points(rectangle)
    assert Enum.any?(corners, &near?(&1, {5.0, 1.0, 0.0}))
    assert Page.json(socket) == %{"credit" => 1}
    refute_received {:left, _}
  end

  defp near?({a, b, c}, {x, y, z}),
    do: abs(a - x) < 1.0e-5 and abs(b - y) < 1.0e-5 and abs(c - z) < 1.0e-5

  test "sends only the newest drawing after one is acknowledged", context do
    {_, socket} = connect(context)
    Page.text(socket, %{offset: 0})
    head = row({0.0, 1.6, 0.0})
    Page.push(socket, 2, moment(16 + 64, head))
    assert %{"layer" => "said", "items" => ["boxes", "texts"]} = drawing(socket)

    for flags <- [64, 64, 16 + 64], i = System.unique_integer([:positive]) do
      Page.push(socket, 2, moment(flags, row({0.0, 1.6, i / 1.0e9})))
      # Times must increase.
      assert_receive {:head, _}
    end

    # However many of the three arrive while one is in flight, the last one is drawn in the end.
    assert newest(socket, 3) == ["boxes", "texts"]
    Page.text(socket, %{drawn: "said"})

    # A page that connects later gets the last drawing.
    :gen_tcp.close(socket)
    {first, socket} = Page.again(fn -> connect(context) end)
    assert %{"layer" => "said", "items" => ["boxes", "texts"]} = drawing(socket, first)
    Page.text(socket, %{drawn: "nothing of this name"})
    assert Page.closed?(socket)
  end

  defp newest(socket, most) do
    Page.text(socket, %{drawn: "said"})

    case drawing(socket) do
      %{"layer" => "said", "items" => []} when most > 1 -> newest(socket, most - 1)
      %{"layer" => "said", "items" => items} -> items
    end
  end

  defp drawing(socket), do: drawing(socket, Page.pull(socket))

  defp drawing(socket, frame) do
    case frame do
      {2, <<5, 0::24, size::little-32, json::binary-size(size), rest::binary>>} ->
        padding = rem(8 - rem(size, 8), 8)
        <<_::binary-size(padding), n::little-32, 0::32, scene::binary-size(n), _::binary>> = rest
        {:ok, told} = JSON.decode(json)
        {:ok, %{"items" => items}} = JSON.decode(scene)
        Map.put(told, "items", Enum.map(items, & &1["kind"]))

      {1, _} ->
        drawing(socket)
    end
  end

  test "invalid bytes end the connection, and the pipeline continues", context do
    nan = <<0, 0, 0xC0, 0x7F>>
    head = row({0.0, 1.6, 0.0})
    plane = %{label: "x", pose: [0, 0, 0, 0, 0, 0, 1], polygon: [[0, 0]]}

    bad = [
      "",
      moment(0, ""),
      moment(0, String.duplicate(nan, 7)),
      moment(0, row({0.0, 1.0, 0.0}, {0.0, 0.0, 0.0, 0.0})),
      moment(0, [head, "more"]),
      moment(1, [head, row({0.0, 0.0, 0.0})]),
      moment(8, head, "no json"),
      moment(8, head, JSON.encode(%{a: 1})),
      moment(8, head, JSON.encode([%{plane | pose: [1]}])),
      moment(8, head, JSON.encode([%{plane | polygon: [[0, "x"]]}])),
      moment(8, head, JSON.encode([%{plane | label: 7}])),
      moment(8, head, JSON.encode(List.duplicate(plane, 300))),
      <<4, 0, 0::48, 1.0::little-float-64>> <> head,
      # This is what a camera's page sends.
      <<1, 0::24, 1::little-16, 1::little-16, Page.now_ms()::little-float-64>> <> <<0xFF, 0xD8>>
    ]

    for bytes <- bad do
      {_, socket} = Page.again(fn -> connect(context) end)
      Page.text(socket, %{offset: 0})
      Page.push(socket, 2, bytes)
      assert Page.closed?(socket), inspect(bytes, limit: 20)
      :gen_tcp.close(socket)
    end

    {_, socket} = Page.again(fn -> connect(context) end)
    Page.text(socket, %{offset: 0})
    Page.push(socket, 2, moment(0, head))
    assert_receive {:head, _}
  end

  test "rejects two drawings with the same name, and an invalid color" do
    twice = fn p ->
      numbers = Situ.from_enumerable(p, 1..3)
      Display.show(numbers, page: "twice", as: "a")
      Display.show(numbers, page: "twice", as: "a")
    end

    assert {:error, error} = Situ.Pipeline.run(twice)
    assert Exception.message(error) =~ ~s(the name "a" is already in use in "twice")

    assert_raise Situ.Error, ~r/invalid colour "red"/, fn ->
      Situ.Pipeline.run(fn p -> p |> Situ.from_enumerable(1..3) |> Display.show(color: "red") end)
      |> elem(1)
      |> raise()
    end
  end
end
