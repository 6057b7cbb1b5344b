defmodule HeadsetFixture do
  # A pipeline with a page as its headset. It writes the last poses to a file that the tests read,
  # and draws a box, a pose and a text at positions that the test checks.
  alias Situ.{Box3, Pose, Skeleton}
  alias Situ.Studio.Headset

  def start(path) do
    {:ok, seen} = Agent.start(fn -> %{moments: 0} end)
    note = fn fun -> write(path, Agent.get_and_update(seen, &both(fun.(&1)))) end

    {:ok, _} =
      Situ.Pipeline.start(
        fn p ->
          headset = Headset.open(p, page: "emulated")
          Situ.each(headset.head, fn pose, m -> note.(&head(&1, pose, m)) end)

          for side <- [:left, :right],
              do: Situ.each(headset[side], fn hand -> note.(&Map.put(&1, side, hand(hand))) end)

          Situ.each(headset.gaze, fn ray -> note.(&Map.put(&1, :gaze, list(ray.direction))) end)
          Situ.each(headset.select, fn pressed -> note.(&Map.put(&1, :select, pressed)) end)

          Situ.each(headset.planes, fn planes -> note.(&Map.put(&1, :planes, flat(planes))) end)

          headset.select
          |> Situ.map(fn _ -> box() end, type: :any)
          |> Headset.Display.show(page: "emulated", as: "box", color: "#ff0000")

          headset.right
          |> Situ.map(&{"hand", &1.joints.wrist}, type: :any)
          |> Headset.Display.show(page: "emulated", as: "hand", color: "#00ff00")
        end,
        pipeline: [name: "Headset"]
      )
  end

  # Two metres in front of the emulated head, and half a metre to the left.
  defp box, do: Box3.new!({1.9, 0.4, 1.5}, {2.1, 0.6, 1.7})

  defp both(map), do: {map, map}

  defp head(seen, %Pose{} = pose, message) do
    {yaw, pitch, _} = Situ.Quaternion.to_euler(pose.rotation)

    Map.merge(seen, %{
      moments: seen.moments + 1,
      head: list(pose.position),
      yaw: yaw,
      pitch: pitch,
      late_ms: (Situ.Time.now() - message.originating_time) / 1.0e6
    })
  end

  defp hand(%Skeleton{} = hand),
    do: %{
      joints: map_size(hand.joints),
      wrist: list(Skeleton.joint_position(hand, :wrist)),
      tip: list(Skeleton.joint_position(hand, :index_finger_tip))
    }

  defp flat(planes),
    do:
      for(
        p <- planes,
        do: %{label: p.label, width: p.rectangle.width, at: list(p.rectangle.pose.position)}
      )

  defp list({x, y, z}), do: [x, y, z]

  defp write(path, seen) do
    new = "#{path}.#{System.unique_integer([:positive])}"
    File.write!(new, Situ.JSON.encode(seen))
    File.rename!(new, path)
  end
end
