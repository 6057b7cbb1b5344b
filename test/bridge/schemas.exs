# Situ's side of the schema tests with MCAP files: `schemas.exs write FOLDER`, `schemas.exs read
# FILE`.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.Mcap
alias Situ.Store

case System.argv() do
  ["write", dir] ->
    image = Situ.Image.new!(width: 2, height: 1, format: :rgb24, data: <<1, 2, 3, 4, 5, 6>>)
    {:ok, jpeg} = Situ.EncodedImage.new(format: :jpeg, data: <<0xFF, 0xD8, 0xFF, 0xE0, 1>>)
    cloud = Situ.PointCloud.from_points([{1.0, 2.0, 3.0}])
    tree = [Situ.Transform.new("robot", "world", Situ.Pose.new({1.0, 0.0, 0.0}))]
    {:ok, place} = Situ.GeoPoint.new(46.5, 14.5, height: 300.0, accuracy: {1.0, 2.0, 3.0})
    imu = Situ.ImuReading.new({0.0, 0.0, 9.81}, {0.0, 0.0, 0.0})

    optics =
      Situ.CameraIntrinsics.new!(width: 64, height: 48, focal: {500, 500}, principal: {32, 24})

    definition = """
    syntax = "proto3";
    package lab;
    message Level {
      enum Kind { RAW = 0; SMOOTH = 1; }
      double volts = 1;
      repeated int64 raw = 2;
      Kind kind = 3;
      map<string, uint32> tags = 4;
    }
    """

    level =
      &%{"volts" => &1 / 2, "raw" => [-1, 2 ** 31], "kind" => "SMOOTH", "tags" => %{"a" => 7}}

    topics = [
      {"/camera", fn _ -> image end, [frame: "lens"]},
      {"/jpeg", fn _ -> jpeg end, []},
      {"/cloud", fn _ -> cloud end, []},
      {"/tf", fn _ -> tree end, []},
      {"/place", fn _ -> place end, []},
      {"/log", &"step #{&1}", []},
      {"/level", level, [type: "lab.Level", definition: definition]}
    ]

    write = fn p, file, topics, common ->
      for {topic, fun, opts} <- topics do
        p
        |> Situ.from_enumerable(for(n <- 0..19, do: {(n + 1) * 1_000_000_007, fun.(n)}))
        |> Mcap.write(file, topic, common ++ opts)
      end
    end

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        write.(p, Mcap.create(p, Path.join(dir, "foxglove.mcap")), topics, encoding: :protobuf)

        ros2 = [
          {"/imu", fn _ -> imu end, [frame: "base"]},
          {"/info", fn _ -> optics end, []},
          {"/tf", fn _ -> tree end, []}
        ]

        write.(p, Mcap.create(p, Path.join(dir, "ros2.mcap"), profile: "ros2"), ros2,
          encoding: :cdr
        )
      end)

  ["read", path] ->
    store = Store.open!(path)
    [] = Store.info(store).damage
    times = for n <- 0..49, do: 1_000_000_007 * (n + 1)

    for {topic, check} <- [
          {"/jpeg", &match?(%Situ.EncodedImage{format: :jpeg}, &1)},
          {"/tf", &match?(%Situ.Transform{frame: "cam", parent: "world"}, &1)},
          {"/scan",
           &match?(%{"ranges" => [0.5, :infinity, :nan], "end_angle" => 1.5, "pose" => nil}, &1)}
        ] do
      {:ok, messages} = Store.read(store, topic, limit: 1_000)
      ^times = Enum.map(messages, & &1.originating_time)
      true = Enum.all?(messages, &check.(&1.data))
    end

    {:ok, %{data: %{"entities" => [entity]}}} = Store.at(store, "/scene", 0)

    %{"id" => "box", "lifetime" => 2_000_000_000, "cubes" => [%{"size" => %{"x" => 1.0}}]} =
      entity
end
