defmodule Situ.Bridge.Mcap.CopyTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.{Mcap, McapRecords}
  alias Situ.Store

  @moduletag :tmp_dir
  @real Path.expand("../../../data/ros1_imu_gps_cam.mcap", __DIR__)

  # Builds a file with everything that is allowed: unknown types, no schema, a topic twice, equal
  # and unordered times, different publish times, gaps in sequences and private records.
  defp file do
    messages =
      for i <- 0..10 do
        %{
          channel: Enum.at([7, 2, 3, 300], rem(i, 4)),
          sequence: i * 1_000_003,
          log: 1_700_000_000_000_000_000 + div(i, 2) * 1_000 - rem(i, 3) * 5_000,
          publish: 1_699_999_999_000_000_000 + i,
          data: binary_part(<<0, 255, "{", i, "bytes that are nothing">>, 0, rem(i * 3, 20))
        }
      end

    %{
      profile: "ros2",
      library: "someone's recorder 1.2",
      compression: :none,
      schemas: [
        {1, "lab/msg/Odd", "ros2msg", "uint8 a\n"},
        {9, "lab.Own", "flatbuffer", <<0, 1, 2, 255>>},
        {10, "lab.Own", "flatbuffer", <<0, 1, 2, 255>>},
        {11, "unused", "jsonschema", "{}"}
      ],
      channels: [
        {2, 1, "/odd", "cdr", %{"offered_qos_profiles" => "- history: 1"}},
        {3, 9, "/own", "flatbuffer", %{}},
        {7, 0, "/bytes", "nobody's", %{"unit" => "dB", "ä" => "ö"}},
        {8, 10, "/silent", "flatbuffer", %{}},
        {300, 1, "/odd", "cdr", %{}}
      ],
      messages: messages,
      attachments: [
        %{log: 5, created: 4, name: "map.png", type: "image/png", data: <<1, 2, 3, 0>>},
        %{log: 6, created: 0, name: "", type: "", data: ""}
      ],
      metadata: [{"car", %{"id" => "7"}}, {"car", %{"id" => "8"}}],
      private: [{0x80, "own"}, {0xFF, ""}]
    }
  end

  defp by_time(messages), do: Enum.sort_by(messages, & &1.log)

  for order <- [:file, :time] do
    test "copies any valid file without changes, in order of #{order}", %{tmp_dir: dir} do
      for features <- McapRecords.variants(),
          compression <- if(:chunked in features, do: [:none, :lz4], else: [:none]) do
        file = %{file() | compression: compression}
        bytes = McapRecords.build(file, features)
        path = Path.join(dir, "in.mcap")
        out = Path.join(dir, "out.mcap")
        File.write!(path, bytes)
        want = McapRecords.read(bytes)

        assert Map.take(want, [:messages, :attachments]) ==
                 Map.take(file, [:messages, :attachments])

        store = Store.open!(path)
        assert length(Mcap.list_attachments(store)) == 2, inspect(features)
        assert %{damage: [], metadata: [_, _]} = Store.info(store)

        assert {:ok, %{messages: 11, left_out: []}} = Mcap.copy(store, out, order: unquote(order))

        got = out |> File.read!() |> McapRecords.read()

        assert {features, compare(got, unquote(order))} ==
                 {features, compare(want, unquote(order))}

        # The new file opens with its own index.
        assert %{closed?: true, damage: []} = Store.info(Store.open!(out))
      end
    end
  end

  defp compare(file, :file),
    do: %{file | schemas: Enum.sort(file.schemas), channels: Enum.sort(file.channels)}

  # Private records are dropped in time order.
  defp compare(file, :time) do
    file = compare(file, :file)
    %{file | messages: by_time(file.messages), private: []}
  end

  test "copies some streams and an interval, recompresses, and adds records", %{tmp_dir: dir} do
    path = Path.join(dir, "in.mcap")
    File.write!(path, McapRecords.build(file(), [:chunked, :indexed, :summary]))
    store = Store.open!(path)
    out = Path.join(dir, "out.mcap")
    from = 1_700_000_000_000_000_000

    assert {:ok, 3} =
             Mcap.export(store, out,
               streams: ["/own", "/odd"],
               from: from,
               compression: :zstd,
               attachments: [{"note", "text/plain", 9, "new"}],
               metadata: %{"robot" => %{"serial" => "7"}}
             )

    copy = Store.open!(out)
    assert [%{compression: "zstd"} | _] = Mcap.list_chunks(copy)
    assert Enum.map(Mcap.list_attachments(copy), & &1.name) == ["map.png", "", "note"]
    assert [{"car", _}, {"car", _}, {"robot", %{"serial" => "7"}}] = Store.info(copy).metadata

    got = for m <- messages(copy), do: {m.originating_time, m.sequence_id}

    want = for m <- file().messages, m.channel in [2, 3], m.log >= from, do: {m.log, m.sequence}

    assert Enum.sort(got) == Enum.sort(want)
    assert {:error, %{code: :no_stream}} = Mcap.copy(store, out, streams: ["/none"])
  end

  defp messages(store),
    do: for(info <- Store.streams(store), message <- Store.messages(store, info), do: message)

  test "rejects a damaged file, or copies everything around the damage", %{tmp_dir: dir} do
    bytes = File.read!(@real)
    chunks = @real |> Store.open!() |> Mcap.list_chunks()
    [first | _] = chunks
    path = Path.join(dir, "in.mcap")
    out = Path.join(dir, "out.mcap")
    at = first.offset + div(first.size, 2)
    <<before::binary-size(at), byte, rest::binary>> = bytes
    File.write!(path, [before, Bitwise.bxor(byte, 0x55), rest])
    store = Store.open!(path)
    assert {:error, %{code: :damaged, fix: fix}} = Mcap.copy(store, out)
    assert fix =~ "recover"

    assert {:ok, %{messages: n, left_out: [sentence]}} = Mcap.copy(store, out, skip_damage: true)

    assert sentence =~ "left out" and n < 545
    lost = 545 - n

    # Reading the streams one by one skips the same messages.
    read =
      for info <- Store.streams(store),
          message <- Store.messages(store, info, skip_damage: true),
          do: message

    assert length(read) == 545 - lost
    assert_raise Situ.Error, fn -> messages(store) end
  end

  test "ignores an index that points to the wrong place, and reports it", %{tmp_dir: dir} do
    bytes = McapRecords.build(file(), [:chunked, :indexed, :summary])
    [%{offset: at, size: size} | _] = chunks(bytes, dir)
    at = at + size
    <<before::binary-size(at), 7, rest::binary>> = bytes
    path = Path.join(dir, "lies.mcap")
    File.write!(path, [before, 0x55, rest])
    store = Store.open!(path)
    assert [sentence] = Store.info(store).damage
    assert sentence =~ "index cannot be read"
    assert length(messages(store)) == 11
  end

  test "does not trust an index that leaves out messages", %{tmp_dir: dir} do
    # A message outside of the chunks, in a file whose chunks have an index.
    bytes = McapRecords.build(file(), [:chunked, :indexed, :summary])
    loose = <<5, 25::little-64, 7::little-16, 1::little-32, 5::little-64, 6::little-64, "abc">>
    [%{offset: at} | _] = chunks(bytes, dir)
    <<before::binary-size(at), rest::binary>> = bytes
    path = Path.join(dir, "loose.mcap")
    # It is not in any part that the summary points to, but directly before the end of the data.
    tail = byte_size(rest)
    rest = put_before_end(rest, tail, loose)
    File.write!(path, before <> rest)
    store = Store.open!(path)
    assert Enum.sum(for s <- Store.streams(store), do: s.count) == 12
  end

  defp chunks(bytes, dir) do
    path = Path.join(dir, "chunks.mcap")
    File.write!(path, bytes)
    path |> Store.open!() |> Mcap.list_chunks()
  end

  defp put_before_end(rest, size, loose) do
    end_of_data = <<15, 4::little-64, 0::32>>
    [{at, _}] = :binary.matches(rest, end_of_data)
    <<data::binary-size(at), behind::binary>> = rest
    # The footer contains the start of the summary, which must be moved.
    body = size - at - 8 - 20
    <<summary::binary-size(body), start::little-64, footer::binary>> = behind
    data <> loose <> summary <> <<start + byte_size(loose)::little-64>> <> footer
  end
end
