defmodule Situ.Bridge.RawMessagesTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.{McapRecords, RawMessages}
  alias Situ.Bridge.Ros.{Bag, Db3}
  alias Situ.Store

  @moduletag :tmp_dir
  @real Path.expand("../../data/ros1_imu_gps_cam.mcap", __DIR__)

  # Types that Situ cannot interpret, equal and unordered times, gaps in sequences.
  defp odd_file(topic, first) do
    messages =
      for i <- 0..20 do
        %{
          channel: if(rem(i, 2) == 0, do: 1, else: 2),
          sequence: i * 7,
          log: first + div(i, 3) * 1_000 - rem(i, 2) * 1_500,
          publish: first - i,
          data: :binary.copy(<<i, 255, 0>>, i)
        }
      end

    %{
      profile: "",
      library: "",
      compression: :none,
      schemas: [{1, "lab/msg/Odd", "ros2idl", "module lab {};"}],
      channels: [
        {1, 1, topic, "cdr",
         %{"offered_qos_profiles" => "- history: 1", "topic_type_hash" => "H"}},
        {2, 1, "/it's", "cdr", %{}}
      ],
      messages: messages,
      attachments: [%{log: 5, created: 4, name: "map.png", type: "image/png", data: <<1, 0>>}],
      metadata: [{"car", %{"id" => topic}}, {"car", %{"id" => "8"}}],
      private: []
    }
  end

  defp write_odd(dir, name, topic, first) do
    path = Path.join(dir, name)
    File.write!(path, McapRecords.build(odd_file(topic, first), [:chunked, :indexed, :summary]))
    path
  end

  defp rows(paths, opts \\ []) do
    stores = paths |> List.wrap() |> Enum.map(&Store.open!/1)

    for m <- RawMessages.stream(stores, opts),
        do: {m.channel.topic, m.log_time, m.publish_time, m.sequence, m.bytes}
  end

  defp without_publishing(rows),
    do: for({topic, log, _, _, bytes} <- rows, do: {topic, log, bytes})

  test "merges MCAP files without a change", %{tmp_dir: dir} do
    a = write_odd(dir, "a.mcap", "/a", 1_000_000)
    b = write_odd(dir, "b.mcap", "/b", 1_005_000)
    out = Path.join(dir, "out.mcap")
    assert {:ok, %{messages: 42, left_out: []}} = RawMessages.copy([a, b], out)

    want = Enum.sort(odd_file("/a", 1_000_000).messages ++ odd_file("/b", 1_005_000).messages)
    got = out |> File.read!() |> McapRecords.read()
    keep = &Map.take(&1, [:log, :publish, :sequence, :data])
    assert got.messages |> Enum.map(keep) |> Enum.sort() == want |> Enum.map(keep) |> Enum.sort()
    logs = Enum.map(got.messages, & &1.log)
    assert logs == Enum.sort(logs)

    # The files share one channel.
    assert {:ok, channels} = RawMessages.channels(Store.open!(out))
    assert channels |> Enum.map(& &1.topic) |> Enum.sort() == ["/a", "/b", "/it's"]
    assert [%{log: 5, created: 4}] = got.attachments

    assert got.metadata ==
             [{"car", %{"id" => "/a"}}, {"car", %{"id" => "8"}}, {"car", %{"id" => "/b"}}]
  end

  test "selects streams and log times, with both ends", %{tmp_dir: dir} do
    path = write_odd(dir, "a.mcap", "/a", 1_000_000)
    all = rows(path)
    assert length(all) == 21

    for from <- [999_500, 1_000_000, 1_001_000], to <- [1_001_000, 1_004_000, 1_004_001] do
      assert rows(path, from: from, to: to, streams: ["/a"]) ==
               for({"/a", log, _, _, _} = row when log in from..to <- all, do: row)
    end
  end

  test "writes bags of ROS 2, also with types that it cannot interpret", %{tmp_dir: dir} do
    path = write_odd(dir, "a.mcap", "/a", 1_000_000)
    out = Path.join([dir, "walk", "walk_0.db3"])
    File.mkdir_p!(Path.dirname(out))
    assert {:ok, %{messages: 21, left_out: [_, _]}} = RawMessages.copy(path, out)
    assert without_publishing(rows(out)) == without_publishing(rows(path))
    {:ok, before} = RawMessages.channels(Store.open!(path))
    {:ok, copied} = RawMessages.channels(Store.open!(out))
    identities = fn channels -> Enum.map(channels, &Situ.Bridge.RawChannel.identity/1) end
    assert identities.(copied) == identities.(before)
    summary = out |> Path.dirname() |> Path.join("metadata.yaml") |> File.read!()
    assert summary =~ "message_count: 21" and summary =~ "- \"walk_0.db3\""

    # Another bag's summary is not overwritten.
    other = Path.join([dir, "walk", "walk_1.db3"])
    assert {:ok, _} = RawMessages.copy(out, other, from: 1_001_000)
    assert out |> Path.dirname() |> Path.join("metadata.yaml") |> File.read!() == summary
    assert without_publishing(rows(other)) == without_publishing(rows(path, from: 1_001_000))
  end

  test "copies bags of ROS 1 with all fields of their connections", %{tmp_dir: dir} do
    [one, two, mcap] = for name <- ~w(one.bag two.bag three.mcap), do: Path.join(dir, name)
    assert {:ok, %{messages: count}} = RawMessages.copy(@real, one)
    assert {:ok, %{messages: ^count}} = RawMessages.copy(one, two, compression: :lz4)
    assert {:ok, %{messages: ^count}} = RawMessages.copy([two], mcap, compression: :zstd)
    want = @real |> rows() |> without_publishing() |> Enum.sort()
    for path <- [one, two, mcap], do: assert(Enum.sort(without_publishing(rows(path))) == want)

    {:ok, channels} = RawMessages.channels(Store.open!(two))
    assert Enum.all?(channels, &List.keymember?(&1.metadata, "md5sum", 0))

    [message | _] =
      @real |> Store.open!() |> RawMessages.stream(streams: ["/chatter"]) |> Enum.take(1)

    assert {:ok, "tick" <> _} = RawMessages.decode(message)
  end

  test "encodes values as messages of ROS 2, with numbers above 2^63", %{tmp_dir: dir} do
    big = 0xFFFF_FFFF_FFFF_FFFF
    {:ok, writer} = Store.Writer.create("big", dir)
    {:ok, stream} = Store.Writer.stream(writer, "/big", type: :map)
    value = %{"big" => big, "list" => [big, 0]}

    {:ok, _} =
      Store.Writer.append(stream, [
        %Situ.Message{data: value, originating_time: 5, creation_time: 5, sequence_id: 1}
      ])

    :ok = Store.Writer.close(writer)
    store = Store.open!(writer.path)
    assert {:ok, [%{data: ^value}]} = Store.read(store, "/big")
    opts = [type: "lab/Big", definition: "uint64 big\nuint64[] list\n"]

    for {module, name} <- [{Bag, "b.bag"}, {Db3, "b.db3"}] do
      path = Path.join(dir, name)
      assert {:ok, 1} = module.export(store, path, opts)
      assert {:ok, [%{data: ^value}]} = Store.read(Store.open!(path), "/big")
    end

    path = Path.join(dir, "b.mcap")
    assert {:ok, 1} = Situ.Bridge.Mcap.export(store, path)
    assert {:ok, [%{data: ^value}]} = Store.read(Store.open!(path), "/big")
    {:ok, again} = Store.copy(Path.join(dir, "b.db3"), Path.join(dir, "again"))
    assert {:ok, [%{data: ^value}]} = Store.read(Store.open!(again), "/big")
  end

  test "restarts an export as JSON with all messages", %{tmp_dir: dir} do
    {:ok, writer} = Store.Writer.create("mixed", dir)
    {:ok, stream} = Store.Writer.stream(writer, "/mixed", type: :integer)

    for {values, first} <- [{[1, 0xFFFF_FFFF_FFFF_FFFF], 1}, {[0xFFFF_FFFF_FFFF_FFFF, -1], 3}],
        {value, n} <- Enum.with_index(values, first) do
      message = %Situ.Message{data: value, originating_time: n, creation_time: n, sequence_id: n}
      {:ok, _} = Store.Writer.append(stream, [message])
    end

    :ok = Store.Writer.close(writer)
    path = Path.join(dir, "mixed.mcap")
    assert {:ok, 4} = writer.path |> Store.open!() |> Situ.Bridge.Mcap.export(path)
    :erlang.garbage_collect()
    assert {:ok, messages} = Store.read(Store.open!(path), "/mixed")

    assert Enum.map(messages, & &1.data["value"]) ==
             [1, 0xFFFF_FFFF_FFFF_FFFF, 0xFFFF_FFFF_FFFF_FFFF, -1]
  end

  test "says why messages cannot be copied", %{tmp_dir: dir} do
    path = write_odd(dir, "a.mcap", "/a", 0x7FFF_FFFF_FFFF_0000)
    assert {:error, %{code: :not_raw, why: why}} = RawMessages.copy(path, Path.join(dir, "a.bag"))
    assert why =~ ~s("cdr")
    assert {:error, %{code: :not_raw}} = RawMessages.copy(path, Path.join(dir, "a.csv"))

    assert {:error, %{code: :no_store}} =
             RawMessages.copy("nothing.mcap", Path.join(dir, "b.mcap"))

    missing = Path.join([dir, "no", "a.db3"])
    assert {:error, %{code: :io}} = RawMessages.copy(path, missing)
    refute RawMessages.copyable?(Store.open!(path), :bag)
    assert RawMessages.copyable?(Store.open!(path), :db3)
  end

  test "reports damage, or skips it", %{tmp_dir: dir} do
    bag = Path.join(dir, "a.bag")
    assert {:ok, %{messages: count}} = RawMessages.copy(@real, bag)
    bytes = File.read!(bag)
    cut = Path.join(dir, "cut.bag")
    File.write!(cut, binary_part(bytes, 0, div(byte_size(bytes), 2)))
    out = Path.join(dir, "out.bag")
    assert {:error, %{code: :damaged}} = RawMessages.copy(cut, out)
    assert {:ok, %{messages: kept}} = RawMessages.copy(cut, out, skip_damage: true)
    assert kept in 1..(count - 1)
    assert rows(out) -- rows(bag) == []
  end
end
