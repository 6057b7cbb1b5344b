defmodule Situ.StoreTest do
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.{Person, Picture, Sound}
  alias Situ.Store.{StreamInfo, Undecoded, Writer}

  doctest Situ.Store

  @moduletag :tmp_dir

  test "every plain term round-trips with its envelope", %{tmp_dir: root} do
    values = [
      1,
      -1,
      9_223_372_036_854_775_807,
      -9_223_372_036_854_775_808,
      170_141_183_460_469_231_731_687_303_715_884_105_727,
      1.5,
      -0.0,
      true,
      false,
      nil,
      "",
      "text",
      String.duplicate("x", 100_000),
      <<1::3>>,
      [],
      [1, [2 | 3]],
      'charlist',
      {},
      {:ok, %{"b" => [nil], a: 1}},
      {:undecodable, "x"},
      %Person{name: "Ada", age: 36},
      %Picture{width: 2, data: <<1, 2, 3, 4>>},
      %Picture{width: 200, data: :binary.copy(<<7>>, 40_000)}
    ]

    for compression <- [:none, :lz4, :zstd], large <- [false, true] do
      written = messages(values)
      options = [compression: compression, large: large]
      store = Store.open!(store(root, [{"All", written, options}]))
      assert Enum.map(Store.messages(store, "All"), &%{&1 | source_id: 0}) == written
    end
  end

  test "a stream of one numeric type is small", %{tmp_dir: root} do
    n = 10_000
    written = for i <- 1..n, do: message(i, i * 100, i * 100 + 7, i)
    path = store(root, [{"Count", written, [type: :integer]}])

    bytes =
      path |> Path.join("*") |> Path.wildcard() |> Enum.map(&File.stat!(&1).size) |> Enum.sum()

    assert bytes / n < 24
  end

  test "reports exact metadata while the store is written and afterwards", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("live", root)
    {:ok, stream} = Writer.stream(writer, "A", type: {:list, :float}, metadata: {"pi", 3.14})
    {:ok, stream} = Writer.append(stream, messages([[1.0], [2.0, 3.0]]))
    store = Store.open!(writer.path)
    assert %{live?: true, closed?: false, name: "live", version: 0} = Store.info(store)
    assert [%StreamInfo{name: "A", type: {:list, :float}, count: 2} = info] = Store.streams(store)

    assert {info.first, info.last, info.first_creation, info.last_creation} ==
             {0, 1_000, 5, 1_005}

    assert {info.latency_sum, StreamInfo.average_latency(info)} == {10, 5.0}
    assert StreamInfo.message_rate(info) == 1.0e6
    refute StreamInfo.closed?(info)
    assert Store.metadata(store, "A") == {:ok, {"pi", 3.14}}
    assert {:error, %{code: :type_mismatch}} = Store.metadata(store, "A", :integer)

    {:ok, stream} = Writer.append(stream, [message([], 2_000)])
    assert Store.count(store, info) == 3
    {:ok, _} = Writer.close_stream(stream, 2_500)
    :ok = Writer.close(writer)
    assert %{live?: false, closed?: true, damage: []} = Store.info(store)
    assert [%{count: 3, closed: 2_500}] = Store.streams(store)
    assert {:error, %{code: :closed}} = Writer.append(stream, [message([], 3_000)])
  end

  test "reads metadata with atoms that this system does not know", %{tmp_dir: root} do
    term = %{known: 1}
    path = store(root, [{"S", messages([1]), [metadata: term]}])
    known = :erlang.term_to_binary(term)
    foreign = String.replace(known, "known", "kn0wn")
    Situ.Store.Test.Raw.replace(path, Base.encode64(known), Base.encode64(foreign))
    assert Store.metadata(Store.open!(path), "S") == {:ok, %{"kn0wn" => 1}}
  end

  test "every recording gets a new version, and the newest version is opened", %{tmp_dir: root} do
    assert store(root, [{"A", messages([1]), []}]) =~ "test.0000"
    assert store(root, [{"A", messages([2]), []}]) =~ "test.0001"
    {:ok, store} = Store.open(Path.join(root, "test"))
    assert {:ok, %{data: 2}} = Store.at(store, "A", 0)
    assert length(Store.list(root)) == 2
    assert Store.exists?(Path.join(root, "test")) and not Store.exists?(Path.join(root, "none"))
  end

  test "refuses data that cannot be stored and loses nothing", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("bad", root)
    {:ok, stream} = Writer.stream(writer, "S")
    {:ok, stream} = Writer.append(stream, messages([1, 2]))

    for {value, word} <- [
          {fn -> 1 end, "function"},
          {&String.upcase/1, "function"},
          {{:a, self()}, "process"},
          {[make_ref()], "reference"}
        ] do
      assert {:error, %{code: :not_storable} = error} =
               Writer.append(stream, [message(3, 5_000), message(value, 6_000)])

      assert Exception.message(error) =~ word
    end

    assert {:error, %{code: :not_increasing, what: what}} =
             Writer.append(stream, [message(0, 1_000)])

    assert what =~ "\"S\""
    assert {:error, %{code: :stream_exists}} = Writer.stream(writer, "S")
    {:ok, _} = Writer.append(stream, [message(3, 5_000)])
    store = Store.open!(writer.path)
    assert store |> Store.messages("S") |> Enum.map(& &1.data) == [1, 2, 3]
  end

  test "refuses a second writer, a locked folder and invalid names", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("x", root)
    assert {:error, %{code: :store_exists}} = Writer.create("x", writer.path, versioned: false)
    assert {:error, %{code: :store_in_use}} = Store.repair(writer.path)
    assert {:error, %{code: :store_in_use}} = Store.delete(writer.path)
    assert {:error, %{code: :bad_name}} = Writer.create("a/b", root)
    file = Path.join(root, "file")
    File.write!(file, "")
    assert {:error, %{code: _, fix: _}} = Writer.create("x", file)
  end

  test "errors say why a file is not a valid store", %{tmp_dir: root} do
    assert {:error, %{code: :no_store}} = Store.open(Path.join(root, "nothing"))
    path = store(root, [{"A", messages([1]), []}])
    index = Path.join(path, "index.situ")
    <<magic::binary-8, _version::little-32, rest::binary>> = good = File.read!(index)
    File.write!(index, [magic, <<3::little-32>>, rest])
    assert {:error, %{code: :newer_version, why: _}} = Store.open(path)
    File.write!(index, "not an index")
    assert {:error, %{code: :not_a_store}} = Store.open(path)
    File.write!(index, good)
    File.rm!(Path.join(path, "data-000000.situ"))
    store = Store.open!(path)
    assert Store.streams(store) == []
    assert {:error, %{code: :missing_extent}} = Store.stream_info(store, "A")
    assert {:ok, %{damage: [_ | _]}} = Store.verify(path)
    assert {:error, %{code: :unknown_format}} = Store.open(file(root, "x.doc", "abc"))
    assert {:error, %{code: :not_csv}} = Store.open(file(root, "x.csv", <<255, 254, 0>>))
  end

  defp file(root, name, bytes) do
    path = Path.join(root, name)
    File.write!(path, bytes)
    path
  end

  test "finds, reports, skips and repairs damage", %{tmp_dir: root} do
    path = store(root, [{"A", messages(Enum.map(1..2_000, &"message #{&1}")), []}])
    data = Path.join(path, "data-000000.situ")
    bytes = File.read!(data)
    {at, _} = :binary.match(bytes, "message 750")
    <<before::binary-size(at), _, rest::binary>> = bytes
    File.write!(data, [before, "X", rest])
    store = Store.open!(path)
    assert {:error, %{code: :damaged} = error} = Store.read(store, "A", limit: 2_000)
    assert error.fix =~ "repair"
    left = store |> Store.messages("A", skip_damage: true) |> Enum.map(& &1.data)
    assert length(left) == 1_900 and "message 800" not in left and "message 801" in left
    assert {:ok, %{damage: [%{file: "data-000000.situ"}]}} = Store.verify(path)
    test = self()
    progress = &send(test, {:done, &1, &2})
    assert {:ok, %{dropped: 1, rebuilt?: true}} = Store.repair(path, progress: progress)
    assert_received {:done, total, total}
    refute_received {:situ_store, _, _}
    assert {:ok, %{damage: []}} = Store.verify(path)
    assert path |> Store.open!() |> Store.messages("A") |> Enum.map(& &1.data) == left
  end

  test "large binaries are not copied, and small ones do not pin a file", %{tmp_dir: root} do
    big = :crypto.strong_rand_bytes(100_000)

    store =
      Store.open!(store(root, [{"P", messages([%Picture{width: 1, data: big}, "small"]), []}]))

    {:ok, [%{data: %Picture{data: data}}, %{data: small}]} = Store.read(store, "P")
    # A binary copied for this process would reference its own size, not that of the map's handle.
    assert data == big and :binary.referenced_byte_size(data) != byte_size(data)
    assert :binary.referenced_byte_size(small) == 5
    # The bytes outlive the store, its files and its reader.
    Store.delete(store.path)
    :erlang.garbage_collect()
    assert data == big
  end

  test "summarizes a stream of numbers and the signal of a codec", %{tmp_dir: root} do
    numbers = messages(Enum.map(0..9_999, &rem(&1 * 37, 101)))
    sounds = for i <- 0..499, do: message(%Sound{samples: Enum.to_list(i..(i + 15))}, i * 16_000)
    store = Store.open!(store(root, [{"N", numbers, []}, {"Audio", sounds, []}]))
    {:ok, width, bins} = Store.summary(store, "N", 0, 10_000_000, 100)
    assert width == 65_536
    assert Enum.all?(bins, fn {start, _, _, _, _} -> rem(start, width) == 0 end)
    assert bins |> Enum.map(&elem(&1, 4)) |> Enum.sum() == 10_000

    for {start, min, max, last, count} <- bins do
      inside =
        for %{data: d, originating_time: t} <- numbers, t >= start and t < start + width, do: d

      assert {min, max, last, count} ==
               {Enum.min(inside) / 1, Enum.max(inside) / 1, List.last(inside) / 1, length(inside)}
    end

    {:ok, _, bins} = Store.summary(store, "Audio", 0, 8_000_000, 50)
    assert bins |> Enum.map(&elem(&1, 4)) |> Enum.sum() == 8_000
    assert bins |> Enum.map(&elem(&1, 2)) |> Enum.max() == 514.0
    {:ok, _, fine} = Store.summary(store, "Audio", 0, 40_000, 40)
    assert {0, 0, 0, 0, 1} = hd(fine)
  end

  test "a codec's signal is complete while its stream is written", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("live", root)
    {:ok, stream} = Writer.stream(writer, "Audio", type: Sound)

    for i <- 0..1_999, reduce: stream do
      stream ->
        sound = message(%Sound{samples: Enum.to_list(i..(i + 15))}, i * 16_000, nil, i + 1)
        {:ok, stream} = Writer.append(stream, [sound])
        stream
    end

    store = Store.open!(writer.path)

    for pixels <- [10, 100, 1_000] do
      {:ok, _, bins} = Store.summary(store, "Audio", 0, 32_000_000, pixels)
      assert bins |> Enum.map(&elem(&1, 4)) |> Enum.sum() == 32_000
      starts = Enum.map(bins, &elem(&1, 0))
      assert starts == Enum.sort(starts) and starts == Enum.uniq(starts)
    end
  end

  test "unknown atoms are read as strings, and unknown structs as maps", %{tmp_dir: root} do
    # Builds a term as a system with other modules would write it.
    name = "Elixir.NeverCompiledHere#{System.unique_integer([:positive])}"
    atom = fn text -> <<119, byte_size(text), text::binary>> end

    term =
      <<131, 116, 0, 0, 0, 2, atom.("__struct__")::binary, atom.(name)::binary,
        atom.("never_seen_field_17")::binary, 97, 3>>

    path = store(root, [{"S", messages([List.duplicate(0, 3), {:a, 1}]), []}])
    reader = Store.open!(path).state.ref
    assert is_reference(reader)

    # Writes the same term as raw bytes of the term encoding. A function in a file is not turned into a function.
    export = <<131, 113, 119, 6, "Elixir", 119, 1, "f", 97, 0>> <> :binary.copy(<<0>>, 20)
    assert %Undecoded{reason: "a function"} = Situ.Store.Test.Raw.decode(root, export)

    assert Situ.Store.Test.Raw.decode(root, term) == %{
             "__struct__" => name,
             "never_seen_field_17" => 3
           }

    # A known struct in a version with a different field also has strings for all its keys.
    term = struct_term("Elixir.Situ.Store.Undecoded", "never_seen_field_18", 3)

    assert Situ.Store.Test.Raw.decode(root, term) == %{
             "__struct__" => "Elixir.Situ.Store.Undecoded",
             "never_seen_field_18" => 3
           }
  end

  defp struct_term(module, field, value) do
    atom = fn text -> <<119, byte_size(text), text::binary>> end

    <<131, 116, 0, 0, 0, 2, atom.("__struct__")::binary, atom.(module)::binary,
      atom.(field)::binary, 97, value>>
  end
end
