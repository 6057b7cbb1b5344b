defmodule Situ.Store.CopyingTest do
  # Stores out of stores: what is kept, what is refused, what is left behind when it does not work out.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.{Person, Picture, Raw, Sound}
  alias Situ.Store.{Undecoded, Writer}

  @moduletag :tmp_dir

  # {"never_heard_of_this_atom", 1} with an atom that is in no system: the tag of a small atom is 119.
  @foreign <<131, 104, 2, 119, 25, "never_heard_of_this_at0m_", 97, 1>>

  defp data(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)

  defp info(path, stream), do: path |> Store.open!() |> Store.stream_info(stream) |> elem(1)

  defp holds?(path, bytes) do
    path |> Path.join("data-*") |> Path.wildcard() |> Enum.any?(&(File.read!(&1) =~ bytes))
  end

  defp makers(root) do
    [
      copy: &Store.copy(&1, {"copied", root}),
      crop: &Store.crop(&1, {"cropped", root}, start: 0),
      concat: &Store.concat([&1], {"joined", root}),
      edit: &Store.edit(&1, {"edited", root}, %{})
    ]
  end

  test "terms with atoms this system has never heard of are kept byte by byte", %{tmp_dir: root} do
    path = Raw.written(root, @foreign)
    assert data(path, "T") == [{"never_heard_of_this_at0m_", 1}]

    for {_, make} <- makers(root) do
      {:ok, made} = make.(path)
      assert holds?(made, @foreign)
      assert data(made, "T") == data(path, "T")
    end
  end

  test "a type, its fields and metadata of modules that are not here are kept", %{tmp_dir: root} do
    options = [type: Person, metadata: %{unit: "m"}]
    path = store(root, [{"P", messages([%Person{name: "Ada"}]), options}])
    Raw.replace(path, ~s("type":"Situ.Store.Test.Person"), ~s("type":"Situ.Store.Test.Nobody"))
    known = Base.encode64(:erlang.term_to_binary(%{unit: "m"}))
    foreign = :erlang.term_to_binary(%{unit: "m"}) |> String.replace("unit", "un1t")
    Raw.replace(path, known, Base.encode64(foreign))
    before = info(path, "P")
    assert before.type == :any and before.type_name == "Situ.Store.Test.Nobody"
    assert {_, ^foreign} = before.supplemental

    for {_, make} <- makers(root) do
      {:ok, made} = make.(path)

      kept = [
        :type_name,
        :fields,
        :module,
        :supplemental,
        :opened,
        :closed,
        :compression,
        :large?
      ]

      assert Map.take(info(made, "P"), kept) == Map.take(before, kept)
      assert data(made, "P") == [%Person{name: "Ada"}]
    end
  end

  test "bytes of a codec that is not here stay its bytes", %{tmp_dir: root} do
    pictures = for i <- 1..3, do: %Picture{width: i, data: :binary.copy(<<i>>, 40_000)}
    path = store(root, [{"Pic", messages(pictures), []}])

    module = ~s("Elixir.Situ.Store.Test.Picture")
    Raw.replace(path, module, String.replace(module, "Picture", "Pixture"))
    Raw.replace(path, ~s("test.picture"), ~s("test.unknown"))
    assert [%Undecoded{codec: "test.unknown"} | _] = data(path, "Pic")

    for {_, make} <- makers(root) do
      {:ok, made} = make.(path)
      assert data(made, "Pic") == data(path, "Pic")
    end
  end

  test "every kind of message, its envelope, statistics and pyramid", %{tmp_dir: root} do
    mixed = [1, 2.5, true, nil, "x", {:a, [1]}, %Picture{width: 1, data: "p"}, %Person{age: 3}]
    numbers = for i <- 0..5_000, do: message(i * 0.5, i * 1_000, i * 1_000 + rem(i, 7), i * 2 + 1)
    sound = for i <- 0..200, do: %Sound{samples: Enum.to_list(i..(i + 15))}

    path =
      store(root, [
        {"Mixed", messages(mixed), []},
        {"Numbers", numbers, [type: :float, compression: :zstd]},
        {"Sound", messages(sound, 16_000), [type: Sound]},
        {"Big", messages([:binary.copy("b", 100_000)]), [large: true]}
      ])

    old = Store.open!(path)

    for {_, make} <- makers(root) do
      {:ok, made} = make.(path)
      assert {:ok, %{damage: []}} = Store.verify(made)
      new = Store.open!(made)

      for stream <- Store.streams(old) do
        same =
          [:name, :type_name, :count, :first, :last, :first_creation, :last_creation, :size] ++
            [:latency_sum, :closed, :large?, :compression]

        assert Map.take(info(made, stream.name), same) == Map.take(stream, same)

        plain = fn store ->
          Enum.map(Store.messages(store, stream.name), &%{&1 | source_id: 0})
        end

        assert plain.(new) == plain.(old)
        span = {0, 5_000_000}
        summary = &Store.summary(&1, stream.name, elem(span, 0), elem(span, 1), 50)
        assert summary.(new) == summary.(old)
      end
    end
  end

  test "an interval within chunks, a chunk that is damaged", %{tmp_dir: root} do
    values = for i <- 0..2_999, do: {i, "some text"}
    path = store(root, [{"T", messages(values), []}])
    {:ok, cropped} = Store.crop(path, {"c", root}, from: 1_234_000, to: 1_300_500)
    assert data(cropped, "T") == Enum.slice(values, 1234..1300)
    file = Path.join(path, "data-000000.situ")
    bytes = File.read!(file)
    {at, _} = :binary.match(bytes, :erlang.term_to_binary({1_500, "some text"}))

    File.write!(file, [
      binary_part(bytes, 0, at + 3),
      99,
      binary_part(bytes, at + 4, byte_size(bytes) - at - 4)
    ])

    {:ok, copied} = Store.copy(path, {"c", root})
    kept = data(copied, "T")
    assert kept == values -- Enum.slice(values, 1500..1599)
    assert {:error, %{code: :damaged}} = Store.copy(path, {"c", root}, skip_damage: false)
    assert Path.wildcard(Path.join(root, "*.unfinished")) == []
  end

  test "codecs of several stores get numbers of their own", %{tmp_dir: root} do
    other = %Picture{width: 9, data: "late"}

    a =
      store(
        root,
        [{"S", messages([%Sound{samples: [1]}, %Picture{width: 1, data: "a"}]), []}],
        "a"
      )

    b = store(root, [{"S", [message(other, 9_000_000)], []}], "b")
    {:ok, made} = Store.concat([a, b], {"ab", root})
    assert data(made, "S") == [%Sound{samples: [1]}, %Picture{width: 1, data: "a"}, other]
  end

  test "edits: replaced, inserted, deleted, the rest untouched", %{tmp_dir: root} do
    path = Raw.written(root, @foreign)
    edits = %{"T" => [{:upsert, -5, "before"}, {:upsert, 7, "behind"}, {:delete, 99}]}
    {:ok, edited} = Store.edit(path, {"e", root}, edits)
    assert data(edited, "T") == ["before", {"never_heard_of_this_at0m_", 1}, "behind"]
    assert holds?(edited, @foreign)
    {:ok, none} = Store.edit(path, {"e", root}, %{"T" => [{:delete, 0}]})
    assert data(none, "T") == []
    numbers = store(root, [{"N", messages([1, 2, 3]), [type: :integer]}])
    {:ok, edited} = Store.edit(numbers, {"e", root}, %{"N" => [{:upsert, 1_000, 20}]})
    [_, changed, _] = edited |> Store.open!() |> Store.messages("N") |> Enum.to_list()
    assert %{data: 20, sequence_id: 2, creation_time: 1_005} = changed
  end

  test "an edit that is not of the stream's type is refused, and nothing is made", %{
    tmp_dir: root
  } do
    path = store(root, [{"N", messages([1, 2, 3]), [type: :integer]}])
    edits = %{"N" => [{:upsert, 0, "one"}]}
    assert {:error, %{code: :type_mismatch, why: why}} = Store.edit(path, {"e", root}, edits)
    assert why =~ ":integer"
    assert Store.newest("e", root) == nil
  end

  test "streams by name and by pattern; one that is not there is an error", %{tmp_dir: root} do
    streams = for name <- ["Room.A", "Room.B", "Hall.A"], do: {name, messages([1]), []}
    path = store(root, streams)
    names = fn path -> path |> Store.open!() |> Store.streams() |> Enum.map(& &1.name) end
    {:ok, made} = Store.copy(path, {"c", root}, streams: ["Room.*"])
    assert names.(made) == ["Room.A", "Room.B"]
    {:ok, made} = Store.copy(path, {"c", root}, streams: ["????.A", "Room.B"])
    assert names.(made) == ["Room.A", "Room.B", "Hall.A"]

    assert {:error, %{code: :no_stream, fix: fix}} =
             Store.copy(path, {"c", root}, streams: ["Room.C"])

    assert fix =~ "Room."
    assert {:error, %{code: :no_stream}} = Store.concat([path], {"c", root}, streams: ["X*"])
  end

  test "what makes no sense is refused before anything is made", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1]), []}])
    out = {"out", root}
    assert {:error, %{code: :unknown_option, fix: fix}} = Store.crop(path, out, strat: 5)
    assert fix =~ ":start"
    assert {:error, %{code: :unknown_option}} = Store.copy(path, out, form: 5)
    assert {:error, %{code: :unknown_option}} = Store.edit(path, out, %{}, ad: [])
    assert {:error, %{code: :no_store, fix: "name at least one"}} = Store.concat([], out)
    assert Store.newest("out", root) == nil
  end

  test "what is not whole has no name, and goes with the next of its name", %{tmp_dir: root} do
    path = store(root, [{"N", messages(Enum.to_list(1..10)), []}])
    test = self()

    # Killed in the middle, as by a Ctrl-C.
    {pid, monitor} =
      spawn_monitor(fn ->
        Store.copy(path, {"out", root},
          progress: fn _, _ ->
            send(test, :half)
            Process.sleep(:infinity)
          end
        )
      end)

    receive do: (:half -> Process.exit(pid, :kill))
    receive do: ({:DOWN, ^monitor, _, _, _} -> :ok)
    assert [_] = Path.wildcard(Path.join(root, "out.*.unfinished"))
    assert Store.newest("out", root) == nil
    refute Enum.any?(Store.list(root), &(&1 =~ "out"))
    assert swept(path, root)
    assert data(Path.join(root, "out"), "N") == Enum.to_list(1..10)
  end

  # The dead process gives its lock up when its memory is collected.
  defp swept(path, root) do
    Enum.any?(1..100, fn _ ->
      :erlang.garbage_collect()
      {:ok, _} = Store.copy(path, {"out", root})
      Path.wildcard(Path.join(root, "out.*.unfinished")) == []
    end)
  end

  test "a store that cannot even begin leaves no folder behind", %{tmp_dir: root} do
    disk = Path.join(root, "disk")
    File.mkdir_p!(disk)

    case System.cmd("mount", ["-t", "tmpfs", "-o", "size=1m", "tmpfs", disk],
           stderr_to_stdout: true
         ) do
      {_, 0} ->
        try do
          ballast = Path.join(disk, "ballast")
          File.write!(ballast, :binary.copy(<<1>>, 1_040_000))
          assert {:error, %{code: :disk_full}} = Writer.create("big", disk)
          assert File.ls!(disk) == ["ballast"]
          # A disk that is nearly full takes what it has room for.
          File.write!(ballast, :binary.copy(<<1>>, 900_000))
          assert {:ok, writer} = Writer.create("little", disk)
          assert {:ok, stream} = Writer.stream(writer, "S")
          assert {:ok, _} = Writer.append(stream, messages([1, 2, 3]))
          assert :ok = Writer.close(writer)
          assert data(writer.path, "S") == [1, 2, 3]
          :ok = Store.delete(writer.path)
          File.rm!(ballast)
          path = store(root, [{"N", messages([1]), []}])
          assert {:ok, _} = Store.copy(path, {"small", disk})

          large =
            store(root, [
              {"L", messages(for(_ <- 1..20, do: :crypto.strong_rand_bytes(100_000))), []}
            ])

          assert {:error, %{code: :disk_full, why: why}} = Store.copy(large, {"large", disk})
          assert why =~ "removed"
          assert File.ls!(disk) == ["small.0000"]
        after
          System.cmd("umount", ["-l", disk])
        end

      {why, _} ->
        IO.puts(:stderr, "not tested, no disk to fill: " <> String.trim(why))
    end
  end

  test "a folder of its own choice, also one that holds other things", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2]), []}])
    target = Path.join(root, "mine")
    assert {:ok, ^target} = Store.copy(path, {"n", target}, versioned: false)
    assert {:error, %{code: :store_exists}} = Store.copy(path, {"n", target}, versioned: false)
    notes = Path.join(root, "notes")
    File.mkdir_p!(notes)
    File.write!(Path.join(notes, "readme.txt"), "mine")
    assert {:ok, ^notes} = Store.copy(path, {"n", notes}, versioned: false)
    assert data(notes, "N") == [1, 2] and "readme.txt" in File.ls!(notes)
  end

  test "what is inserted behind a stream's end is replayed, and is in copies", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2, 3]), [type: :integer]}])

    {:ok, edited} =
      Store.edit(path, Path.join(root, "edited"), %{
        "N" => [{:upsert, 9_000, 4}, {:delete, 9_500}]
      })

    assert [%{closed: 9_000}] = Store.streams(Store.open!(edited))
    {:ok, copied} = Store.copy(edited, Path.join(root, "copied"))

    for path <- [edited, copied] do
      assert path |> Situ.Store.Test.Play.replay("N") |> Enum.map(& &1.data) == [1, 2, 3, 4]
    end
  end

  test "compacting makes full chunks of many small commits, in place", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("small", root)
    {:ok, stream} = Writer.stream(writer, "N", type: :integer, metadata: %{"unit" => "m"})

    stream =
      Enum.reduce(1..300, stream, fn i, stream ->
        {:ok, stream} = Writer.append(stream, [message(i, i * 1_000)])
        stream
      end)

    assert {:error, %{code: :store_in_use}} = Store.compact(writer.path)
    {:ok, _} = Writer.close_stream(stream, 300_000)
    :ok = Writer.close(writer)
    [before] = Store.streams(Store.open!(writer.path))
    path = writer.path
    assert {:ok, ^path} = Store.compact(path)
    [now] = Store.streams(Store.open!(path))
    assert now.stored * 10 < before.stored
    assert {now.count, now.closed, now.first, now.last} == {300, 300_000, 1_000, 300_000}
    assert data(path, "N") == Enum.to_list(1..300)
    assert Store.metadata(Store.open!(path), "N") == {:ok, %{"unit" => "m"}}
    assert File.ls!(root) == ["small.0000"]
    assert {:error, %{code: :unknown_option}} = Store.compact(path, from: 1)
  end
end
