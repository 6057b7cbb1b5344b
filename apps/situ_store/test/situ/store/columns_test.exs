defmodule Situ.Store.ColumnsTest do
  # Numbers are written and read as columns with the same times, values and envelopes as message by message.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Columns, Message, Pipeline, Store}

  @replay [pipeline: [replay: [speed: :max]]]

  # Runs of values of one kind each, and how far apart the sequence ids are.
  defp runs do
    values =
      one_of([
        list(integer(-(2 ** 63), 2 ** 63 - 1)),
        list(float()),
        list(boolean()),
        list(one_of([nil, "x", 1, 1.5, :nan]))
      ])

    {list(values), one_of([1, 1, 2])}
  end

  defp messages({runs, step}) do
    for {value, n} <- runs |> Enum.concat() |> Enum.with_index(1) do
      %Message{
        data: value,
        originating_time: n * 1_000_000,
        creation_time: n * 1_000_000 + div(n, 3),
        sequence_id: n * step
      }
    end
  end

  # Each part of the runs as columns, where this is possible.
  defp items(messages, most) do
    Enum.map(Enum.chunk_every(messages, most), fn part ->
      case Columns.from_messages(part) do
        {:ok, columns} -> columns
        :error -> part
      end
    end)
  end

  defmodule Emit do
    # Emits prepared items, columns or lists of messages, with their envelopes.
    use Situ.Component, outputs: [out: :any], options: [items: [type: :any, required: true]]

    @impl true
    def init(opts), do: {:ok, opts[:items]}

    @impl true
    def handle_demand(_n, _context, []), do: {[{:complete, 0}, {:close, :out}], []}
    def handle_demand(_n, _context, [item | rest]), do: {[{:out, item}], rest}
  end

  defp record(dir, items) do
    {:ok, _} =
      Pipeline.run(
        fn p ->
          store = Store.create(p, "t", dir)
          p |> Situ.source(Emit, items: items) |> Store.write(store, "V")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    Store.open!(Path.join(dir, "t"))
  end

  defp envelopes(messages),
    do: for(m <- messages, do: {m.originating_time, m.creation_time, m.sequence_id, m.data})

  defp replayed(store, operator) do
    {:ok, messages} =
      Situ.collect(
        &(&1 |> Store.importer(store.path) |> Store.stream("V") |> operator.()),
        @replay
      )

    messages
  end

  property "a recording contains the same messages, and replays them", numtests: 60 do
    forall {runs, most} <- {runs(), integer(1, 12)} do
      dir = Path.join(System.tmp_dir!(), "situ-columns-#{System.unique_integer([:positive])}")
      messages = messages(runs)
      by_columns = record(Path.join(dir, "columns"), items(messages, most))
      by_messages = record(Path.join(dir, "messages"), Enum.chunk_every(messages, most))
      assert envelopes(Store.messages(by_messages, "V")) === envelopes(messages)
      assert envelopes(Store.messages(by_columns, "V")) === envelopes(messages)

      if messages != [] do
        assert envelopes(replayed(by_columns, & &1)) === envelopes(messages)
        alone = &Situ.filter(&1, fn _ -> true end, async: true)
        assert Enum.map(replayed(by_columns, alone), & &1.data) === Enum.map(messages, & &1.data)
      end

      File.rm_rf!(dir)
      true
    end
  end

  @tag :tmp_dir
  test "a loop and an interval replay the same numbers", %{tmp_dir: dir} do
    numbers = for n <- 1..3_000, do: %Message{data: n, originating_time: n, sequence_id: n}
    store = record(dir, items(numbers, 700))

    read = fn importer, settings ->
      {:ok, messages} =
        Situ.collect(
          &(&1
            |> Store.importer(store.path, importer)
            |> Store.stream("V")
            |> Situ.each(fn _ -> :ok end, columns: true)),
          pipeline: [replay: [speed: :max] ++ settings]
        )

      messages
    end

    assert Enum.map(read.([], interval: {501, 2_700}), & &1.data) == Enum.to_list(501..2_700)
    looped = read.([loop: 3_000], interval: {1, 7_000})
    assert Enum.map(looped, & &1.data) == 1..3_000 |> Stream.cycle() |> Enum.take(length(looped))
    assert length(looped) == 7_000
    assert Enum.map(looped, & &1.originating_time) == Enum.to_list(1..7_000)
  end
end
