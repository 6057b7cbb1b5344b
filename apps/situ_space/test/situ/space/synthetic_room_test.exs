defmodule Situ.Space.SyntheticRoomTest do
  use ExUnit.Case, async: true
  alias Situ.{Box3, CameraView, DepthImage, PointCloud, Pose, Ray3, Skeleton, Store, Vector3}
  alias Situ.Space.{Camera, DepthCamera, SyntheticRoom}
  alias Situ.Space.SyntheticRoom.{Person, Scene, Voice}
  doctest Person
  doctest Scene
  doctest Voice

  @small [width: 64, height: 48, rate: 10, seconds: 1]
  @walls Box3.new!({-1.0, -2.2, 0.0}, {5.0, 2.2, 2.8})

  # Returns every stream of the room as a list of messages.
  defp run(opts) do
    test = self()

    build = fn p ->
      camera = DepthCamera.open(p, {SyntheticRoom, opts})
      streams = Map.merge(camera.others, %{depth: camera.depth, color: camera.color})
      for {name, stream} <- streams, do: Situ.each(stream, &send(test, {name, &1, &2}))
    end

    {:ok, _} =
      Situ.Pipeline.run(build, pipeline: [replay: [interval: {0, 60_000_000_000}, speed: :max]])

    collect(%{})
  end

  defp collect(found) do
    receive do
      {name, data, message} ->
        collect(
          Map.update(
            found,
            name,
            [{message.originating_time, data}],
            &[{message.originating_time, data} | &1]
          )
        )
    after
      0 -> Map.new(found, fn {name, rows} -> {name, Enum.reverse(rows)} end)
    end
  end

  test "emits every stream at the requested rate, the same each time" do
    seen = run(@small)
    assert length(seen.depth) == 10
    assert length(seen.bodies) == 10
    assert Enum.map(seen.depth, &elem(&1, 0)) == for(i <- 0..9, do: i * 100_000_000)
    assert length(seen.imu) == 91
    {times, buffers} = Enum.unzip(seen.sound)
    assert Enum.sum(Enum.map(buffers, &Situ.AudioBuffer.frame_count/1)) == 14_400
    assert List.last(times) == div(14_401 * 1_000_000_000, 16_000)
    assert run(@small) == seen
  end

  test "the depth of every pixel equals the depth of the point its ray meets" do
    scene = Scene.state_at(1.3, nil, 0.05)
    intrinsics = SyntheticRoom.camera_intrinsics(64, 48)
    {:ok, table} = Situ.Space.RayTable.new(intrinsics)
    {:ok, {view, _color}} = SyntheticRoom.render_views(scene, intrinsics, table)

    # With nothing but the walls, computed from boxes and rays.
    for x <- 0..63//7, y <- 0..47//5 do
      {:ok, ray} = Camera.ray_in_view(view, {x, y})
      {wall, _facet} = Box3.intersect_ray(@walls, ray)
      {:ok, measured} = DepthImage.fetch_distance(view.viewed, x, y)
      {depth, _, _} = Pose.transform_point(Pose.invert(view.pose), wall)
      assert measured <= depth + 0.001
    end

    # Heads and the ball are at their positions, unless something is in front of them.
    ball = depth_towards(view, scene.ball)
    assert_in_delta ball, Vector3.distance(scene.ball, view.pose.position) - 0.12, 0.03
    [_, pointing] = scene.bodies
    head = Skeleton.joint_position(pointing, :head)

    assert_in_delta depth_towards(view, head),
                    Vector3.distance(head, view.pose.position) - 0.13,
                    0.03
  end

  # The distance along the ray towards a point of the room at which something is seen.
  defp depth_towards(%CameraView{} = view, point) do
    {:ok, {x, y}} = Camera.project_in_view(view, point)
    pixel = {round(x), round(y)}
    {:ok, depth} = DepthImage.fetch_distance(view.viewed, round(x), round(y))
    {:ok, at} = Camera.unproject(view.intrinsics, pixel, depth)
    Vector3.norm(at)
  end

  test "the arm points at the ball" do
    for t <- [0.0, 2.7, 9.1] do
      scene = Scene.state_at(t)
      assert Ray3.distance_to(Scene.pointing_ray(scene), scene.ball) < 1.0e-9
    end
  end

  test "limbs keep their lengths while a person walks" do
    lengths = fn t ->
      [body | _] = Scene.state_at(t).bodies

      for {a, b} <- body.bones,
          do: Vector3.distance(Skeleton.joint_position(body, a), Skeleton.joint_position(body, b))
    end

    for t <- [0.4, 1.7, 3.3],
        {a, b} <- Enum.zip(lengths.(0.0), lengths.(t)),
        do: assert_in_delta(a, b, 1.0e-9)
  end

  test "the inertial sensor measures gravity at rest, and in motion matches its pose" do
    {x, y, z} = Scene.imu_reading(1.0, 0.0).acceleration
    assert_in_delta Vector3.norm({x, y, z}), 9.80665, 1.0e-6
    assert x < 0 and abs(y) < 1.0e-9

    # The sum of the angular velocities is the rotation from the first pose to the last.
    turn =
      Enum.reduce(0..999, Scene.state_at(0.0, nil, 0.1).camera.rotation, fn n, q ->
        {x, y, z} = Scene.imu_reading((n + 0.5) / 1000, 0.1).angular_velocity
        length = Vector3.norm({x, y, z})

        step =
          Situ.Quaternion.from_axis_angle({x / length, y / length, z / length}, length / 1000)

        Situ.Quaternion.multiply(q, step)
      end)

    assert Situ.Quaternion.angle_between(turn, Scene.state_at(1.0, nil, 0.1).camera.rotation) <
             1.0e-3
  end

  test "audio is loud while someone is speaking and silent in between" do
    seen = run([speech: [{0, 0.2, 0.5}]] ++ @small)

    loud =
      for {time, buffer} <- seen.sound,
          Enum.count(Situ.AudioBuffer.to_samples(buffer), &(abs(&1) > 1_000)) > 100,
          do: time

    assert Enum.map(loud, &div(&1, 100_000_000)) == [3, 4, 5]
    assert for({time, %{0 => true}} <- seen.speaking, do: div(time, 100_000_000)) == [2, 3, 4]
  end

  test "an impossible camera is an error" do
    assert {:error, error} =
             Situ.Pipeline.run(fn p -> DepthCamera.open(p, {SyntheticRoom, rate: 0}).depth end)

    assert Exception.message(error) =~ "rate"
  end

  @tag :tmp_dir
  test "a recording of it works like a camera", %{tmp_dir: folder} do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          room = DepthCamera.open(p, {SyntheticRoom, @small})
          store = Store.create(p, "room", folder)
          Store.write(room.depth, store, "Depth")
          Store.write(room.color, store, "Color")
          Store.write(room.others.bodies, store, "Bodies")
        end,
        pipeline: [replay: [interval: {0, 60_000_000_000}, speed: :max]]
      )

    path = Path.join(folder, "room.0000")
    test = self()

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        camera =
          DepthCamera.open(p, {DepthCamera.Recording, path: path, others: [bodies: "Bodies"]})

        Situ.each(camera.depth, &send(test, {:depth, &1, &2}))
        Situ.each(camera.color, &send(test, {:color, &1, &2}))
        Situ.each(camera.others.bodies, &send(test, {:bodies, &1, &2}))
        Situ.each(DepthCamera.clouds(camera, sparsity: 4), &send(test, {:clouds, &1, &2}))
      end)

    seen = collect(%{})
    live = run(@small)
    for name <- [:depth, :color, :bodies], do: assert(seen[name] == live[name])

    # In the room's frame the floor is at 0, wherever the camera was.
    for {_, cloud} <- seen.clouds do
      %Box3{min: {_, _, floor}} = PointCloud.bounding_box(cloud)
      assert_in_delta floor, 0.0, 0.02
    end
  end
end
