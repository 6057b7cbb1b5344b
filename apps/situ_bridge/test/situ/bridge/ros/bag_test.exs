defmodule Situ.Bridge.Ros.BagTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros.Bag
  alias Situ.Store

  @moduletag :tmp_dir
  # Recorded by ROS 1's own `rosbag record`. The .mcap file next to it contains the same messages.
  @real Path.expand("../../../data/ros1_imu_gps_cam.bag", __DIR__)

  defp data(store, name),
    do: for(m <- Store.messages(store, name), do: {m.originating_time, m.data})

  test "reads the same messages from a real bag as from its MCAP conversion" do
    bag = Store.open!(@real)
    mcap = Store.open!(String.replace_suffix(@real, ".bag", ".mcap"))

    assert Enum.sort(Enum.map(Store.streams(bag), & &1.name)) ==
             Enum.sort(Enum.map(Store.streams(mcap), & &1.name))

    for info <- Store.streams(bag), do: assert(data(bag, info.name) == data(mcap, info.name))
    assert {:ok, 260} = {:ok, Store.count(bag, "/imu/data_raw") + Store.count(bag, "/chatter")}
    {:ok, m} = Store.at(bag, "/imu/mag", 100)
    assert {:ok, ^m} = Store.first_at(bag, "/imu/mag", m.originating_time)
    assert {:ok, ^m} = Store.latest_at(bag, "/imu/mag", m.originating_time)
    {:ok, [%{data: nil}]} = Store.read(bag, "/imu/mag", envelopes: true, limit: 1)
    stamped = Store.open!(@real, reader_opts: [times: :header])
    {:ok, m} = Store.at(stamped, "/imu/mag", 100)
    assert m.originating_time == m.data["header"]["stamp"]
  end

  test "writes a bag and reads it back", %{tmp_dir: dir} do
    path = Path.join(dir, "copy.bag")
    store = Store.open!(@real)

    sizes =
      for compression <- [:none, :lz4] do
        assert {:ok, 545} = Bag.export(store, path, chunk: 20_000, compression: compression)
        copy = Store.open!(path)
        assert %{closed?: true, damage: []} = Store.info(copy)
        for i <- Store.streams(store), do: assert(data(copy, i.name) == data(store, i.name))
        File.stat!(path).size
      end

    assert [plain, packed] = sizes
    assert packed < 0.7 * plain
  end

  test "records images, strings and maps of a custom type", %{tmp_dir: dir} do
    path = Path.join(dir, "own.bag")

    {:ok, image} =
      Situ.Image.new(width: 4, height: 2, format: :bgr24, data: :binary.copy(<<1, 2, 3>>, 8))

    depth = %Situ.DepthImage{width: 1, height: 1, stride: 2, data: <<1_500::little-16>>}

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        bag = Bag.create(p, path)
        p |> Situ.from_enumerable([{10, image}]) |> Bag.write(bag, "/image")
        p |> Situ.from_enumerable([{20, depth}]) |> Bag.write(bag, "/depth")
        p |> Situ.from_enumerable([{5, "hello"}, {30, "you"}]) |> Bag.write(bag, "/text")

        p
        |> Situ.from_enumerable([{7, %{"a" => 1, "b" => [0.5]}}])
        |> Bag.write(bag, "/own", type: "my/Own", definition: "int32 a\nfloat64[] b")
      end)

    store = Store.open!(path)
    assert data(store, "/image") == [{10, image}]
    assert data(store, "/depth") == [{20, depth}]
    assert data(store, "/text") == [{5, "hello"}, {30, "you"}]
    assert data(store, "/own") == [{7, %{"a" => 1, "b" => [0.5]}}]
  end

  test "reads the complete messages of a truncated or unindexed bag", %{tmp_dir: dir} do
    path = Path.join(dir, "whole.bag")
    {:ok, 545} = Bag.export(Store.open!(@real), path, chunk: 5_000)
    want = data(Store.open!(path), "/imu/mag")
    bytes = File.read!(path)
    cut = Path.join(dir, "cut.bag")

    for size <- Enum.take_random(4_200..(byte_size(bytes) - 1), 60) do
      File.write!(cut, binary_part(bytes, 0, size))
      store = Store.open!(cut)
      got = if Store.has_stream?(store, "/imu/mag"), do: data(store, "/imu/mag"), else: []
      assert got == Enum.take(want, length(got))
    end
  end

  test "rejects other files, and reads damaged ones as far as possible", %{tmp_dir: dir} do
    path = Path.join(dir, "x.bag")
    File.write!(path, "#ROSBAG V1.2\n")
    assert {:error, %{code: :not_bag, what: what}} = Store.open(path)
    assert what =~ "1.2"
    File.write!(path, "something else")
    assert {:error, %{code: :not_bag}} = Store.open(path)
    bytes = File.read!(@real)
    :rand.seed(:exsss, {9, 9, 9})

    for _ <- 1..150 do
      at = :rand.uniform(byte_size(bytes)) - 1
      <<before::binary-size(at), _, rest::binary>> = bytes
      File.write!(path, before <> <<Enum.random([0, 1, 0x7F, 0x80, 0xFF])>> <> rest)

      case Store.open(path) do
        {:ok, store} -> for info <- Store.streams(store), do: Store.read(store, info)
        {:error, %Situ.Error{}} -> :ok
      end
    end
  end
end
