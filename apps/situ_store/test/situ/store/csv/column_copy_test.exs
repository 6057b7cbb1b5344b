defmodule Situ.Store.Csv.ColumnCopyTest do
  use ExUnit.Case, async: true
  alias Situ.Store
  alias Situ.Store.{Csv, Summary, Writer}

  @moduletag :tmp_dir

  # Some blocks of a thousand rows in the random tables are plain, and others are not.
  @rows 2_300

  test "copies of random tables contain the same messages as reads and single appends",
       %{
         tmp_dir: root
       } do
    for seed <- 1..6 do
      :rand.seed(:exsss, {seed, 7, 1})
      path = Path.join(root, "random#{seed}.csv")
      File.write!(path, table())
      store = Store.open!(path)
      {:ok, copy} = Store.copy(path, Path.join(root, "copy#{seed}"))
      rows = by_message(store, Path.join(root, "rows"))
      compare(store, Store.open!(copy), Store.open!(rows))

      {first, last} = Store.interval(store)
      [from, to] = Enum.sort(for _ <- 1..2, do: first + :rand.uniform(last - first))
      {:ok, cut} = Store.copy(path, Path.join(root, "cut#{seed}"), from: from, to: to)
      cut = Store.open!(cut)

      for info <- Store.streams(store) do
        wanted = for m <- messages(store, info.name), elem(m, 0) in from..to, do: m
        assert messages(cut, info.name) == wanted
      end
    end
  end

  defp compare(store, copy, rows) do
    {first, last} = Store.interval(store)
    assert names(copy) == names(store)

    for info <- Store.streams(store) do
      assert messages(copy, info.name) == messages(store, info.name)
      {:ok, copied} = Store.stream_info(copy, info.name)
      {:ok, written} = Store.stream_info(rows, info.name)
      assert described(copied) == described(written)

      for pixels <- [3, 500] do
        {:ok, summary} = Summary.read(rows, info.name, first, last, pixels)
        assert {:ok, ^summary} = Summary.read(copy, info.name, first, last, pixels)
      end
    end
  end

  defp names(store), do: Enum.map(Store.streams(store), & &1.name)

  defp described(info),
    do: Map.take(info, [:type, :type_name, :count, :first, :last, :first_creation, :closed])

  defp messages(store, name) do
    for m <- Store.messages(store, name),
        do: {m.originating_time, m.creation_time, m.sequence_id, m.data}
  end

  defp by_message(store, out) do
    {:ok, writer} = Writer.create(Path.basename(out), Path.dirname(out))

    for info <- Store.streams(store) do
      {:ok, stream} = Writer.stream(writer, info.name, type: info.type)

      store
      |> Store.messages(info)
      |> Enum.chunk_every(1_000)
      |> Enum.each(&({:ok, _} = Writer.append(stream, &1)))

      if info.closed, do: {:ok, _} = Writer.close_stream(stream, info.closed)
    end

    :ok = Writer.close(writer)
    writer.path
  end

  defp table do
    kinds =
      for _ <- 1..(1 + :rand.uniform(4)), do: pick([:integer, :float, :text, :mixed, :empty])

    odd = :rand.uniform(@rows)
    dates? = :rand.uniform(2) == 1
    heading = ["time" | for(i <- 1..length(kinds), do: "c#{i}")]

    rows =
      for i <- 1..@rows do
        if i == odd,
          do: odd_row(i, dates?, kinds),
          else: row(i, dates?, Enum.map(kinds, &field/1))
      end

    ending = pick(["\n", "\r\n"])
    Enum.map([Enum.join(heading, ",") | rows], &[&1, ending])
  end

  defp row(i, dates?, fields) do
    case :rand.uniform(200) do
      1 -> Enum.join([time(i - 5, dates?) | fields], ",")
      2 -> Enum.join([time(i, dates?), "more" | fields], ",")
      3 -> Enum.join(["soon" | fields], ",")
      _ -> Enum.join([time(i, dates?) | fields], ",")
    end
  end

  # Builds a row with a date that only the slow path parses, or a number that only terms can store.
  defp odd_row(_i, true, kinds),
    do: Enum.join(["1970-01-02" | Enum.map(kinds, &field/1)], ",")

  defp odd_row(i, false, kinds) do
    fields =
      for kind <- kinds, do: if(kind == :integer, do: "123456789012345678901", else: field(kind))

    Enum.join([time(i, false) | fields], ",")
  end

  defp time(i, false), do: "#{i}.#{rem(i, 7)}25"
  defp time(i, true), do: Situ.Time.to_iso8601(i * 50_000_000_000)

  defp field(kind) do
    if :rand.uniform(10) == 1, do: pick(["", "  "]), else: full(kind)
  end

  defp full(:empty), do: ""
  defp full(:integer), do: to_string(:rand.uniform(0x1FFFFFFFFFFFF) - 1_000_000)

  defp full(:float),
    do: pick(["#{:rand.normal()}", "#{:rand.uniform(9)}", "1.5e#{:rand.uniform(300)}"])

  defp full(:text), do: pick(["idle", " walk ", ~s("a ""b"", c"), ~s("two\nlines"), "NaN", "9é"])
  defp full(:mixed), do: pick([full(:integer), full(:float), "NaN", "inf", "1e999", "-"])

  defp pick(list), do: Enum.random(list)

  test "merges columns of several files into the same streams", %{tmp_dir: root} do
    [one, two] = for name <- ["one.csv", "two.csv"], do: Path.join(root, name)
    File.write!(one, "t,x,note\n1,5,a\n2,,b\n")
    File.write!(two, "t,x,note\n3,6,\n4,7,c\n")
    {:ok, both} = Store.concat([two, one], Path.join(root, "both"))
    both = Store.open!(both)
    s = 1_000_000_000
    assert messages(both, "x") == [{s, s, 1, 5}, {3 * s, 3 * s, 1, 6}, {4 * s, 4 * s, 2, 7}]
    assert for({_, _, _, data} <- messages(both, "note"), do: data) == ["a", "b", "c"]

    # This also works together with recordings of other kinds, and for any interval.
    {:ok, stored} = Store.copy(two, Path.join(root, "two"), to: 1_000_000_000_000_000_000_000)

    {:ok, mixed} =
      Store.concat([stored, one], Path.join(root, "mixed"), from: -1_000_000_000_000_000_000_000)

    mixed = Store.open!(mixed)
    for name <- ["x", "note"], do: assert(messages(mixed, name) == messages(both, name))
  end

  test "progress counts messages, and a changed file is an error", %{tmp_dir: root} do
    path = Path.join(root, "t.csv")
    File.write!(path, ["t,x,y\n" | for(i <- 1..40_000, do: "#{i},#{i},\n")])
    test = self()
    progress = &send(test, {:done, &1, &2})
    {:ok, _} = Store.copy(path, Path.join(root, "copy"), progress: progress)
    assert_received {:done, 32_000, 40_000}
    assert_received {:done, 40_000, 40_000}

    {:ok, state} = Csv.open(path, [])
    File.write!(path, "t,x,y\n1,2,\n")
    {:ok, writer} = Writer.create("other", root)
    [x, _y] = Csv.streams(state)
    {:ok, stream} = Writer.stream(writer, "x", type: :integer)
    result = Csv.append_streams(state, [{x, stream}], {0, 0x7FFFFFFFFFFFFFFF}, fn _ -> :ok end)
    assert {:error, %{code: :damaged, what: what}} = result
    assert what =~ "has changed since it was opened"
    :ok = Writer.close(writer)
  end

  test "an error of the store names the stream", %{tmp_dir: root} do
    path = Path.join(root, "t.csv")
    File.write!(path, "t,x,y\n1,2,3\n2,3,4\n")
    {:ok, state} = Csv.open(path, [])
    {:ok, writer} = Writer.create("late", root)

    targets =
      for info <- Csv.streams(state) do
        {:ok, stream} = Writer.stream(writer, info.name, type: :integer)
        {info, stream}
      end

    {_, y} = List.last(targets)

    late = %Situ.Message{
      data: 1,
      originating_time: 9_000_000_000,
      creation_time: 1,
      sequence_id: 1
    }

    {:ok, _} = Writer.append(y, [late])
    interval = {0, 0x7FFFFFFFFFFFFFFF}
    assert {:error, error} = Csv.append_streams(state, targets, interval, fn _ -> :ok end)
    assert error.code == :not_increasing and error.what =~ ~s("y")
    :ok = Writer.close(writer)
    # An append writes everything or nothing.
    assert Enum.map(Store.streams(Store.open!(writer.path)), & &1.count) == [0, 1]
  end
end
