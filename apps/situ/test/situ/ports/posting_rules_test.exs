defmodule Situ.Ports.PostingRulesTest do
  # Messages with equal times are an error, dropped or nudged; a time that goes back is always an error.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Message, Pipeline}

  @moduletag :capture_log

  defmodule Times do
    # Emits at the given times, together or one by one, as data or as messages with their own envelope.
    use Situ.Component,
      outputs: [out: :any],
      options: [
        times: [type: :list],
        at_once: [type: :boolean, default: true],
        as: [type: {:in, [:data, :messages, :batch, :columns]}, default: :data]
      ]

    @impl true
    def init(opts), do: {:ok, {Enum.with_index(opts[:times], 1), opts[:at_once], opts[:as]}}

    @impl true
    def handle_demand(_n, context, {[], at_once, as}),
      do: {[{:complete, context.start_time + 1_000}], {[], at_once, as}}

    def handle_demand(_n, _context, {items, true, :batch}) do
      messages = for item <- items, do: item |> post(:messages) |> elem(1)
      {[{:out, messages}], {[], true, :batch}}
    end

    def handle_demand(_n, _context, {items, true, :columns}) do
      {times, data} = Enum.unzip(items)
      {[{:out, times, data}], {[], true, :columns}}
    end

    def handle_demand(_n, _context, {items, true, as}),
      do: {Enum.map(items, &post(&1, as)), {[], true, as}}

    def handle_demand(_n, _context, {[item | rest], false, as}),
      do: {[post(item, as)], {rest, false, as}}

    defp post({time, n}, :data), do: {:out, time, n}

    defp post({time, n}, :messages) do
      {:out, %Message{data: n, originating_time: time, creation_time: n, sequence_id: n}}
    end
  end

  defp run(opts, common) do
    me = self()
    tag = make_ref()

    result =
      Pipeline.run(
        fn p ->
          p
          |> Situ.source(Times, opts ++ common)
          |> Situ.each(fn n, m -> send(me, {tag, m.originating_time, n}) end)
        end,
        pipeline: [replay: [interval: {0, 1_000}, speed: :max]]
      )

    {result, got(tag)}
  end

  defp got(tag) do
    receive do
      {^tag, time, n} -> [{time, n} | got(tag)]
    after
      0 -> []
    end
  end

  for as <- [:data, :messages], at_once <- [true, false] do
    test "each policy applies to #{as} posted #{if at_once, do: "together", else: "one by one"}" do
      opts = [times: [5, 5, 5, 6, 20], as: unquote(as), at_once: unquote(at_once)]
      assert {{:error, %{code: :time_not_increasing}}, first} = run(opts, [])
      # The actions of one callback succeed or fail together.
      assert first == if(unquote(at_once), do: [], else: [{5, 1}])

      assert {{:ok, _}, [{5, 1}, {6, 4}, {20, 5}]} = run(opts, on_same_time: :drop)

      assert {{:ok, _}, [{5, 1}, {6, 2}, {7, 3}, {8, 4}, {20, 5}]} =
               run(opts, on_same_time: :nudge)

      for how <- [:drop, :nudge] do
        back = [times: [5, 20, 15], as: unquote(as), at_once: unquote(at_once)]
        assert {{:error, %{code: :time_not_increasing}}, _} = run(back, on_same_time: how)
      end
    end
  end

  property "a batch behaves like its messages one after another", numtests: 60 do
    forall {steps, how} <- {list(integer(-1, 3)), integer(0, 2)} do
      times = steps |> Enum.scan(&+/2) |> Enum.map(&(&1 + 40))
      common = Enum.at([[], [on_same_time: :drop], [on_same_time: :nudge]], how)
      {whole, got} = run([times: times, as: :batch], common)
      {each, expected} = run([times: times, as: :messages], common)

      assert elem(whole, 0) == elem(each, 0)
      assert got == expected
    end
  end

  property "columns behave like their messages one after another", numtests: 60 do
    forall {steps, how} <- {list(integer(-1, 3)), integer(0, 2)} do
      times = steps |> Enum.scan(&+/2) |> Enum.map(&(&1 + 40))
      common = Enum.at([[], [on_same_time: :drop], [on_same_time: :nudge]], how)
      {columns, got} = run([times: times, as: if(times == [], do: :data, else: :columns)], common)
      {each, expected} = run([times: times, as: :data], common)

      assert elem(columns, 0) == elem(each, 0)
      assert got == expected
    end
  end

  defmodule Uneven do
    use Situ.Component, outputs: [out: :any], options: [columns: [type: :any]]
    @impl true
    def init(opts), do: {:ok, opts[:columns]}
    @impl true
    def handle_demand(_n, _context, {times, data} = state), do: {[{:out, times, data}], state}
  end

  test "columns of different lengths, or without times, are not an action" do
    for columns <- [{[1, 2], [:a]}, {[1, :b], [:a, :b]}] do
      build = fn p -> p |> Situ.source(Uneven, columns: columns) |> Situ.each(& &1) end
      assert {:error, %{code: :bad_action}} = Pipeline.run(build)
    end
  end

  property "nudged times strictly increase, lose no message and stay unchanged if possible" do
    forall gaps <- list(integer(0, 3)) do
      times = gaps |> Enum.scan(&+/2) |> Enum.map(&(&1 + 1))
      {{:ok, _}, got} = run([times: times], on_same_time: :nudge)

      expected =
        Enum.map_reduce(times, 0, fn time, last -> {max(time, last + 1), max(time, last + 1)} end)
        |> elem(0)

      assert Enum.map(got, &elem(&1, 0)) == expected
    end
  end

  test "times that do not fit into 64 bits are refused with an error" do
    ExUnit.CaptureLog.capture_log(fn ->
      for time <- [
            93_000_000_000_000_000_000,
            9_000_000_000_000_000_000,
            -8_000_000_000_000_000_000
          ],
          make <- [&{&1, :late}, &%Situ.Message{originating_time: &1, data: :late}] do
        build = fn p ->
          p |> Situ.from_enumerable([make.(time)]) |> Situ.each(& &1, async: true)
        end

        replay = [interval: {-9_000_000_000_000_000_000, :unbounded}, speed: :max]

        assert {:error, %{code: :time_out_of_range, meta: %{time: ^time}}} =
                 Situ.Pipeline.run(build, pipeline: [replay: replay])
      end
    end)
  end
end
