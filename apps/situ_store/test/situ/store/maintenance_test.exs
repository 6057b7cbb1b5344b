defmodule Situ.Store.MaintenanceTest do
  use ExUnit.Case, async: true
  alias Situ.Store
  alias Situ.Store.Writer
  import Situ.Store.Test.Record, only: [message: 2]

  @moduletag :tmp_dir

  # Writes a batch of strings that ends with an integer: the writer starts with strings, then rewrites the batch as
  # terms.
  defp mixed(root) do
    {:ok, writer} = Writer.create("mixed", root)
    {:ok, texts} = Writer.stream(writer, "Texts")
    {:ok, other} = Writer.stream(writer, "Other", type: :integer)

    batch =
      for(i <- 1..1_000, do: message(String.pad_leading("#{i}", 100), i)) ++ [message(7, 1_001)]

    {:ok, _} = Writer.append(texts, batch)
    {:ok, _} = Writer.append(other, for(i <- 1..10, do: message(i, i)))
    :ok = Writer.close(writer)
    writer.path
  end

  defp data(path, name), do: path |> Store.open!() |> Store.messages(name) |> Enum.map(& &1.data)

  # Finds the index entry of a stream's first chunk of messages; entries have 64 bytes and start after one page.
  defp entry_at(index, stream) do
    Enum.find(Stream.iterate(4_096, &(&1 + 64)), fn at ->
      <<_::binary-size(at), _crc::32, id::little-32, level, _::binary>> = index
      id == stream and level == 0
    end)
  end

  defp flip(path, at) do
    bytes = File.read!(path)
    <<before::binary-size(at), byte, rest::binary>> = bytes
    File.write!(path, [before, Bitwise.bxor(byte, 1), rest])
  end

  test "damage in the index entry of one stream does not affect other streams", %{tmp_dir: root} do
    path = mixed(root)
    before = data(path, "Texts")
    index = Path.join(path, "index.situ")
    flip(index, entry_at(File.read!(index), 2) + 40)
    assert {:ok, %{damage: [%{file: "index.situ"}]}} = Store.verify(path)
    assert {:ok, %{recovered: 1, dropped: 0, rebuilt?: true}} = Store.repair(path)
    assert data(path, "Texts") == before
    assert data(path, "Other") == Enum.to_list(1..10)
    assert {:ok, %{damage: []}} = Store.verify(path)
  end

  test "no message is lost if the index is some bytes short", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("short", root)
    {:ok, stream} = Writer.stream(writer, "N", type: :integer)

    Enum.reduce(1..230, stream, fn i, stream ->
      {:ok, stream} = Writer.append(stream, [message(i, i)])
      stream
    end)

    :ok = Writer.close(writer)
    path = writer.path
    index = File.read!(Path.join(path, "index.situ"))

    # After an interrupted copy, readers use the intact index entries; repair recovers the others from the data.
    for missing <- [3, 2_000, 4_096, 10_000] do
      File.write!(
        Path.join(path, "index.situ"),
        binary_part(index, 0, byte_size(index) - missing)
      )

      read = path |> data("N") |> length()
      assert {:ok, report} = Store.repair(path)
      assert report.dropped == 0 and report.unconfirmed == 0
      assert read == 230 or (report.recovered > 0 and report.damage != [])
      assert data(path, "N") == Enum.to_list(1..230)
      assert {:ok, %{damage: []}} = Store.verify(path)
    end
  end

  test "a lost index is rebuilt without unacknowledged data", %{tmp_dir: root} do
    path = mixed(root)
    before = data(path, "Texts")
    File.rm!(Path.join(path, "index.situ"))
    assert {:error, %{code: :index_lost}} = Store.open(path)
    assert {:ok, %{rebuilt?: true}} = Store.repair(path)
    assert data(path, "Texts") == before
    assert data(path, "Other") == Enum.to_list(1..10)
  end

  test "a dry run reports the same result and changes nothing", %{tmp_dir: root} do
    path = mixed(root)
    index = File.read!(Path.join(path, "index.situ"))
    <<offset::little-64>> = binary_part(index, entry_at(index, 1) + 16, 8)
    flip(Path.join(path, "data-000000.situ"), offset + 500)
    files = fn -> for f <- File.ls!(path), into: %{}, do: {f, File.read!(Path.join(path, f))} end
    before = files.()
    {:ok, told} = Store.repair(path, dry_run: true)
    assert files.() == before
    assert {:ok, ^told} = Store.repair(path)
    assert told.dropped > 0 and told.rebuilt?
    # Each repair keeps the index that it found.
    flip(Path.join(path, "index.situ"), 4_100)
    assert {:ok, _} = Store.repair(path)
    assert File.exists?(Path.join(path, "index.situ.before-repair-2"))
    assert {:error, %{code: :unknown_option}} = Store.repair(path, dryrun: true)
  end

  test "reads and repairs a store of version 1", %{tmp_dir: root} do
    golden = Path.expand("../../../../../priv/golden/store-v1.0000", __DIR__)
    path = Path.join(root, "store-v1.0000")
    File.cp_r!(golden, path)

    expected = %{
      "Ints" => Enum.to_list(1..700),
      "Flags" => for(i <- 1..700, do: rem(i, 100) < 50),
      "Texts" => for(i <- 1..200, do: String.duplicate("abc#{i} ", 5)),
      "Terms" => for(i <- 1..100, do: %{"k" => i, "l" => [1, 2, {i}]}),
      "Large" => for(i <- 1..2, do: :binary.copy(<<i>>, 500))
    }

    for {name, data} <- expected, do: assert(data(path, name) == data)
    assert {:ok, _, [_ | _]} = Store.summary(Store.open!(path), "Flags", 0, 700_000, 10)
    assert Store.metadata(Store.open!(path), "Ints") == {:ok, %{"unit" => "m"}}
    assert {:ok, %{damage: []}} = Store.verify(path)
    {:ok, copy} = Store.copy(path, Path.join(root, "copy"))
    for {name, data} <- expected, do: assert(data(copy, name) == data)
    File.rm!(Path.join(path, "index.situ"))
    assert {:ok, %{dropped: 0}} = Store.repair(path)
    for {name, data} <- expected, do: assert(data(path, name) == data)
  end

  test "truncating an open file is an error and does not crash the VM", %{tmp_dir: root} do
    for file <- ["data-000000.situ", "index.situ"], length <- [0, 4_096] do
      {:ok, writer} = Writer.create("cut", root)
      {:ok, stream} = Writer.stream(writer, "S")

      stream =
        Enum.reduce(1..20, stream, fn k, stream ->
          batch =
            for i <- (k * 500 + 1)..((k + 1) * 500), do: message(:binary.copy(<<i::64>>, 50), i)

          {:ok, stream} = Writer.append(stream, batch)
          stream
        end)

      store = Store.open!(writer.path)
      assert {:ok, [_]} = Store.read(store, "S", limit: 1)
      {:ok, device} = :file.open(Path.join(writer.path, file), [:read, :write, :raw])
      {:ok, _} = :file.position(device, length)
      :ok = :file.truncate(device)
      :ok = :file.close(device)
      assert {:error, %{code: :damaged, why: why}} = Store.read(store, "S", limit: 1_000_000)
      assert why =~ "cut while it was open"

      if file == "index.situ",
        do: assert({:error, %{code: :damaged}} = Writer.append(stream, [message("x", 99_999)]))

      _ = Writer.close(writer)
    end
  end
end
