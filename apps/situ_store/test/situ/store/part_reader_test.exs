defmodule Situ.Store.PartReaderTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Message, Store}
  alias Situ.Columns
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  # Records a stream of these values, one millisecond apart, in appends of the given length.
  defp recorded(dir, values, opts \\ []) do
    {:ok, writer} = Writer.create("t", dir)
    {:ok, stream} = Writer.stream(writer, "V", Keyword.take(opts, [:compression]))

    values
    |> Enum.with_index(1)
    |> Enum.map(fn {value, n} ->
      %Message{
        data: value,
        originating_time: n * 1_000_000,
        creation_time: n * 1_000_000 + rem(n, 7),
        sequence_id: n
      }
    end)
    |> Enum.chunk_every(opts[:append] || 1_000)
    |> Enum.reduce(stream, fn messages, stream ->
      {:ok, stream} = Writer.append(stream, messages)
      stream
    end)

    :ok = Writer.close(writer)
    Store.open!(writer.path)
  end

  # Flattens columns and lists into `{time, creation time, value}`.
  defp flat(parts) do
    Enum.flat_map(parts, fn
      %Columns{} = columns ->
        creations = for <<time::little-signed-64 <- columns.creation_times>>, do: time
        assert byte_size(columns.times) == 8 * columns.count
        pairs = Columns.to_pairs(columns)
        assert length(pairs) == columns.count
        for {{time, value}, creation} <- Enum.zip(pairs, creations), do: {time, creation, value}

      messages ->
        for m <- messages, do: {m.originating_time, m.creation_time, m.data}
    end)
  end

  defp messages(store, opts \\ []) do
    for m <- Store.messages(store, "V", opts), do: {m.originating_time, m.creation_time, m.data}
  end

  property "columns contain the same values as messages", numtests: 40 do
    value =
      one_of([
        list(integer(-(2 ** 63), 2 ** 63 - 1)),
        list(float()),
        list(boolean()),
        list(one_of([nil, true, "x", 2 ** 64, 1, 1.5, :nan, %{a: 1}]))
      ])

    forall {runs, append, compression} <-
             {list(value), integer(1, 50), one_of([:none, :lz4, :zstd])} do
      dir = Path.join(System.tmp_dir!(), "situ-columns-#{System.unique_integer([:positive])}")
      store = recorded(dir, Enum.concat(runs), append: append, compression: compression)
      same? = flat(Store.columns(store, "V")) === messages(store)
      File.rm_rf!(dir)
      same?
    end
  end

  test "returns many numbers in one column", %{tmp_dir: dir} do
    store = recorded(dir, for(n <- 1..50_000, do: n / 3), append: 5_000)
    assert [%Columns{kind: :float, count: 50_000}] = Enum.to_list(Store.columns(store, "V"))
  end

  test "returns a time interval", %{tmp_dir: dir} do
    store = recorded(dir, Enum.to_list(1..5_000))
    span = [from: 1_500_000_000, to: 3_000_500_000]

    assert [%Columns{kind: :integer, count: 1_501}] =
             parts = Enum.to_list(Store.columns(store, "V", span))

    assert flat(parts) == messages(store, span)
    assert Enum.to_list(Store.columns(store, "V", from: 9_000_000_000)) == []
    assert Enum.to_list(Store.columns(store, "V", to: 5)) == []
  end

  test "splits columns at any length", %{tmp_dir: dir} do
    for values <- [[1, 2, 3, 4, 5], [true, false, true]], most <- 1..6 do
      store = recorded(Path.join(dir, "#{most}"), values)
      [columns] = Enum.to_list(Store.columns(store, "V"))
      parts = Columns.split(columns, most)
      assert Enum.all?(parts, &(&1.count <= most))
      assert flat(parts) == flat([columns])
    end
  end

  test "damage raises an error, or is skipped with skip_damage: true", %{tmp_dir: dir} do
    store = recorded(dir, Enum.to_list(1..20_000))
    file = Path.join(store.path, "data-000000.situ")
    {:ok, device} = :file.open(file, [:read, :write, :raw, :binary])
    {:ok, %{size: size}} = File.stat(file)
    at = div(size, 2)
    {:ok, <<byte>>} = :file.pread(device, at, 1)
    :ok = :file.pwrite(device, at, <<Bitwise.bxor(byte, 255)>>)
    :ok = :file.close(device)

    store = Store.open!(store.path)
    assert_raise Situ.Error, fn -> Enum.to_list(Store.columns(store, "V")) end
    kept = flat(Store.columns(store, "V", skip_damage: true))
    assert kept == messages(store, skip_damage: true)
    assert length(kept) in 10_000..19_999
  end
end
