defmodule Situ.Store.CopyingTest do
  # Stores derived from other stores: which properties are kept, and which requests are refused.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.{Person, Picture, Raw, Sound}
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  defp data(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)

  defp info(path, stream), do: path |> Store.open!() |> Store.stream_info(stream) |> elem(1)

  defp makers(root) do
    [
      copy: &Store.copy(&1, {"copied", root}),
      crop: &Store.crop(&1, {"cropped", root}, start: 0),
      concat: &Store.concat([&1], {"joined", root}),
      edit: &Store.edit(&1, {"edited", root}, %{})
    ]
  end

  test "keeps a type, its fields and metadata of unknown modules", %{tmp_dir: root} do
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

  test "keeps every kind of message with its envelope, statistics and pyramid", %{tmp_dir: root} do
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

  test "crops within chunks and skips a damaged chunk", %{tmp_dir: root} do
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

  test "selects streams by name or pattern, and refuses unknown streams", %{tmp_dir: root} do
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

  test "refuses invalid requests before creating anything", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1]), []}])
    out = {"out", root}
    assert {:error, %{code: :unknown_option, fix: fix}} = Store.crop(path, out, strat: 5)
    assert fix =~ ":start"
    assert {:error, %{code: :unknown_option}} = Store.copy(path, out, form: 5)
    assert {:error, %{code: :unknown_option}} = Store.edit(path, out, %{}, ad: [])
    assert {:error, %{code: :no_store, fix: "name at least one"}} = Store.concat([], out)
    assert Store.newest("out", root) == nil
  end

  test "compacting merges many small commits into full chunks in place", %{tmp_dir: root} do
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
