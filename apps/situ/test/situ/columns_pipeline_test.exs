defmodule Situ.ColumnsPipelineTest do
  # Columns have the same effect as their messages one by one, whatever takes them and wherever they are split.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Columns, Interval, Message}

  @replay [pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]]

  defmodule Receiver do
    # Passes on what arrives, and counts how.
    use Situ.Component, inputs: [in: :any], outputs: [out: :any], options: [counts: [type: :any]]

    @impl true
    def init(opts), do: {:ok, opts[:counts]}

    @impl true
    def handle_message(:in, message, _context, counts) do
      :counters.add(counts, 1, 1)
      {[{:out, message}], counts}
    end

    @impl true
    def handle_columns(:in, columns, _context, counts) do
      :counters.add(counts, 2, columns.count)
      {[{:out, columns}], counts}
    end
  end

  defmodule Switch do
    # Takes only booleans.
    use Situ.Component, inputs: [in: :boolean], outputs: [out: :boolean]

    @impl true
    def handle_message(:in, message, _context, state), do: {[{:out, message}], state}
  end

  # Numbers of one kind at increasing times, and the length of the parts that become columns.
  defp rows do
    number = integer(-(2 ** 60), 2 ** 60)
    values = one_of([list(number), list(float()), list(boolean())])

    map({values, list(integer(1, 40))}, fn {values, steps} ->
      times = Enum.scan(steps, &+/2)
      more = Stream.iterate(Enum.max([0 | times]) + 1, &(&1 + 3))
      times |> Stream.concat(more) |> Enum.zip(values)
    end)
  end

  defp parts, do: {rows(), integer(1, 9)}

  defp columns({rows, most}) do
    for part <- Enum.chunk_every(rows, most) do
      {times, values} = Enum.unzip(part)
      Columns.new(times, values)
    end
  end

  defp run(items, operator) do
    {:ok, messages} = Situ.collect(&(&1 |> Situ.from_enumerable(items) |> operator.()), @replay)
    for m <- messages, do: {m.originating_time, m.sequence_id, m.data}
  end

  property "every operator computes the same from columns as from messages" do
    operators = [
      & &1,
      &Situ.map(&1, fn x -> {x, x} end),
      &Situ.filter(&1, fn x -> x > 0 end),
      &Situ.scan(&1, [], fn x, all -> [x | Enum.take(all, 2)] end),
      &Situ.window(&1, -1..1),
      &Situ.window(&1, -2..0),
      &Situ.window(&1, Interval.past(30)),
      &(&1 |> Situ.map(fn x -> x end, async: true) |> Situ.map(fn x -> x end, async: true)),
      &Situ.via(&1, Receiver, counts: :counters.new(2, [])),
      &Situ.join(&1, Situ.filter(&1, fn x -> x > 0 end), 20),
      &Situ.first(&1, 3),
      &Situ.last(&1, 2)
    ]

    forall {{rows, most}, n} <- {parts(), integer(0, length(operators) - 1)} do
      operator = Enum.at(operators, n)
      assert run(columns({rows, most}), operator) === run(rows, operator)
    end
  end

  property "functions of columns compute the same as functions of data" do
    forall {rows, most} <- parts() do
      negate = &for(x <- Columns.values(&1), do: if(is_boolean(x), do: not x, else: -x))
      by_columns = &Situ.map(&1, negate, columns: true)
      by_data = &Situ.map(&1, fn x -> if is_boolean(x), do: not x, else: -x end)
      expected = run(rows, by_data)
      assert run(columns({rows, most}), by_columns) === expected
      assert run(rows, by_columns) === expected

      counted =
        &Situ.map(&1, fn c -> {:integer, :binary.copy(<<7::little-64>>, c.count)} end,
          columns: true
        )

      assert run(rows, counted) === run(rows, &Situ.map(&1, fn _ -> 7 end))
    end
  end

  property "windows of columns have the same values as windows of data" do
    windows = [
      -3..0,
      0..0,
      -1..2,
      1..2,
      -4..-2,
      Interval.past(25),
      Interval.past(40, false)
    ]

    forall {{rows, most}, n} <- {parts(), integer(0, length(windows) - 1)} do
      window = Enum.at(windows, n)
      by_columns = &Situ.window(&1, window, fn c -> Columns.values(c) end, with: :columns)
      expected = run(rows, &Situ.window(&1, window, fn list -> list end))
      assert run(columns({rows, most}), by_columns) === expected
      assert run(rows, by_columns) === expected
    end
  end

  test "columns arrive as columns where both sides know them" do
    rows = for n <- 1..5_000, do: {n, n}
    counts = :counters.new(2, [])
    pass = &Situ.via(&1, Receiver, counts: counts)

    double = fn c ->
      for <<n::little-signed-64 <- c.values>>, into: <<>>, do: <<2 * n::little-64>>
    end

    got = run(columns({rows, 700}), &(&1 |> Situ.map(double, columns: true) |> pass.()))
    assert got == for({n, n} <- rows, do: {n, n, 2 * n})
    assert {:counters.get(counts, 1), :counters.get(counts, 2)} == {0, 5_000}
  end

  defmodule Both do
    # Reports the form of what arrives.
    use Situ.Component, inputs: [in: :any], outputs: [out: :any], options: [test: [type: :pid]]

    @impl true
    def init(opts), do: {:ok, opts[:test]}

    @impl true
    def handle_messages(:in, messages, _context, test) do
      send(test, {:messages, length(messages)})
      {[], test}
    end

    @impl true
    def handle_columns(:in, columns, _context, test) do
      send(test, {:columns, columns.count})
      {[], test}
    end
  end

  test "a component with both callbacks takes numbers as they were emitted" do
    me = self()
    build = fn items -> &(&1 |> Situ.from_enumerable(items) |> Situ.via(Both, test: me)) end
    assert {:ok, []} = Situ.collect(build.([Columns.new([1, 2, 3], [1, 2, 3])]), @replay)
    assert_received {:columns, 3}
    assert {:ok, []} = Situ.collect(build.([{1, 1}, {2, 2}, {3, 3}]), @replay)
    assert_received {:messages, 3}
    refute_received {:columns, _}
  end

  test "a function of columns may return another kind" do
    positive = fn columns -> for x <- Columns.values(columns), do: x > 0 end

    build = fn p ->
      p
      |> Situ.from_enumerable([Columns.new([1, 2], [-1.5, 1.5])])
      |> Situ.map(positive, columns: true)
      |> Situ.via(Switch)
    end

    assert {:ok, [%Message{data: false}, %Message{data: true}]} = Situ.collect(build, @replay)
  end

  test "a function that fails at a message fails at this message" do
    inverse = fn c -> for x <- Columns.values(c), do: 1 / x end

    build = fn p ->
      p
      |> Situ.from_enumerable([Columns.new([1, 2, 3, 4], [1, 2, 0, 4])])
      |> Situ.map(inverse, columns: true, on_error: :skip)
    end

    assert {:ok, messages} = Situ.collect(build, @replay)
    assert [%Message{data: 1.0}, %Message{data: 0.5}, %Message{originating_time: 4}] = messages
  end

  test "wrong columns are errors with a reason" do
    columns = Columns.new([1, 2, 3], [1, 2, 3])

    for {wrong, code, text} <- [
          {%{columns | count: 2}, :not_columns, "count: "},
          {%{columns | values: <<>>}, :not_columns, "count: "},
          {%{columns | times: <<2::little-64, 2::little-64, 3::little-64>>}, :time_not_increasing,
           "2 ns"}
        ] do
      assert {:error, error} = Situ.collect(&Situ.from_enumerable(&1, [wrong]), @replay)
      assert error.code == code
      assert Exception.message(error) =~ text
    end

    text = &Situ.map(Situ.from_enumerable(&1, [{1, "a"}]), fn c -> c end, columns: true)
    assert {:error, %{code: :not_columns} = error} = Situ.collect(text, @replay)
    assert Exception.message(error) =~ ~s("a")

    few = &Situ.map(Situ.from_enumerable(&1, [columns]), fn _ -> [] end, columns: true)
    assert {:error, %{code: :not_columns}} = Situ.collect(few, @replay)
  end

  test "a window of columns needs a function and ends at its message" do
    for {window, fun} <- [
          {-1..0, nil},
          {Interval.closed(-5, 5), & &1},
          {3, & &1}
        ] do
      build =
        &(&1 |> Situ.from_enumerable(1..3, every: 1) |> Situ.window(window, fun, with: :columns))

      assert {:error, %{code: :build_failed}} = Situ.collect(build)
    end
  end
end
