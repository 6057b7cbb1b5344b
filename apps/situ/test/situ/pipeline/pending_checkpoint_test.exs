defmodule Situ.Pipeline.PendingCheckpointTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Pipeline, Time}

  @moduletag timeout: 120_000, capture_log: true
  @fast [replay: [interval: {0, Time.s(3600)}, speed: :max]]

  defmodule Echo do
    # Has a process in its state and no snapshot/1, so it cannot be checkpointed.
    use Situ.Component, inputs: [in: :any], outputs: [out: :any]

    @impl true
    def init(_opts), do: {:ok, %{pid: self(), count: 0}}

    @impl true
    def handle_message(:in, message, _context, state),
      do: {[{:out, message.originating_time, state.count}], %{state | count: state.count + 1}}
  end

  defmodule Counter do
    use Situ.Component, inputs: [in: :any], outputs: [out: :any]

    @impl true
    def init(_opts), do: {:ok, %{pid: self(), count: 0}}

    @impl true
    def handle_message(:in, message, _context, state),
      do: {[{:out, message.originating_time, state.count}], %{state | count: state.count + 1}}

    @impl true
    def snapshot(state), do: {:ok, state.count}
    @impl true
    def restore(count, fresh), do: {:ok, %{fresh | count: count}}
  end

  defmodule Steps do
    # Emits its number whenever messages are requested, and `{:first, k}` when it starts.
    use Situ.Component, outputs: [out: :any], options: [k: [type: :integer, required: true]]

    @impl true
    def init(opts), do: {:ok, opts[:k]}

    @impl true
    def handle_start(context, k), do: {[{:out, context.now, {:first, k}}], k}

    @impl true
    def handle_demand(_n, context, k), do: {[{:out, context.now, k}], k}
  end

  # Builds two sources, joins, a window, a running sum and a component with a process in its state.
  defp build(me, n) do
    fn p ->
      left = Situ.from_enumerable(p, Stream.map(1..n, & &1), every: 1_000, name: "Left")
      right = Situ.sequence(p, 1, &rem(&1 * 7 + 1, 101), count: n, every: 1_500)

      left
      |> Situ.join(right, Situ.Reproducible.nearest(800))
      |> Situ.map(fn {a, b} -> a * 1_000 + b end)
      |> Situ.scan(0, &rem(&1 + &2, 1_000_003))
      |> Situ.window(-3..0, &Enum.sum/1)
      |> Situ.via(Counter)
      |> Situ.join(Situ.map(left, &(&1 + 1)), Situ.Reproducible.nearest(2_500))
      |> Situ.each(&send(me, {:out, &1, &2.originating_time, &2.sequence_id}))
    end
  end

  defp reference(n) do
    {:ok, _} = Pipeline.run(build(self(), n), pipeline: @fast)
    heard([])
  end

  defp heard(list) do
    receive do
      {:out, data, time, seq} -> heard([{data, time, seq} | list])
    after
      0 -> Enum.reverse(list)
    end
  end

  # Runs until a checkpoint after `wait` messages, kills the pipeline and resumes from the checkpoint.
  defp interrupted(n, waits, resume \\ %{}, before \\ []) do
    settings = Keyword.put(@fast, :resume, resume)
    {:ok, p} = Pipeline.start(build(self(), n), pipeline: settings)

    case waits do
      [] ->
        {:ok, _} = Pipeline.await(p, 60_000)
        before ++ heard([])

      [wait | rest] ->
        first = collect(wait, p)

        case Pipeline.checkpoint(p, &{&1, first ++ heard([])}, timeout: 60_000) do
          {:ok, {memories, list}} ->
            Process.exit(p, :kill)
            ref = Process.monitor(p)
            assert_receive {:DOWN, ^ref, _, _, _}, 30_000
            gone(memories, p)
            heard([])
            memories = memories |> :erlang.term_to_binary() |> :erlang.binary_to_term()
            interrupted(n, rest, memories, before ++ list)

          {:error, %{code: code}} when code in [:not_running] ->
            {:ok, _} = Pipeline.await(p)
            before ++ first ++ heard([])
        end
    end
  end

  defp collect(0, _p), do: []

  defp collect(n, p) do
    receive do
      {:out, data, time, seq} -> [{data, time, seq} | collect(n - 1, p)]
    after
      50 -> if Pipeline.state(p) == :completed, do: [], else: collect(n, p)
    end
  end

  # The stages of a killed pipeline end by themselves.
  defp gone(_memories, _p), do: Process.sleep(20)

  test "a killed pipeline resumes from its checkpoint with the same output" do
    expected = reference(3_000)
    assert length(expected) > 2_900
    assert interrupted(3_000, [700, 400]) == expected
  end

  property "a pipeline resumes correctly wherever it is interrupted", numtests: 30 do
    expected = reference(600)

    forall {a, b} <- {integer(0, 300), integer(0, 200)} do
      interrupted(600, [a, b]) == expected
    end
  end

  defmodule Late do
    # Emits a result of another process later, so its first snapshots are not complete.
    use Situ.Component, inputs: [in: :any], outputs: [out: :any]

    @impl true
    def init(_opts), do: {:ok, []}

    @impl true
    def handle_message(:in, message, _context, waiting), do: {[], waiting ++ [message]}

    @impl true
    def handle_info(:emit, _context, waiting),
      do: {for(m <- waiting, do: {:out, m.originating_time, m.data}), []}

    def handle_info(_other, _context, waiting), do: {[], waiting}

    @impl true
    def snapshot([]), do: {:ok, []}

    def snapshot(_waiting) do
      send(self(), :emit)
      {:error, Situ.Error.new(:not_settled, "results are expected")}
    end

    @impl true
    def restore([], []), do: {:ok, []}
  end

  test "a component that is not settled is asked again after its results" do
    me = self()

    build = fn p ->
      p
      |> Situ.from_enumerable(Stream.cycle([1]), every: Time.ms(1))
      |> Situ.via(Late)
      |> Situ.each(&send(me, {:out, &1, 0, 0}))
    end

    {:ok, p} = Pipeline.start(build, [])

    # Late emits nothing before it is asked for its state.
    counts = Stream.repeatedly(fn -> Pipeline.checkpoint(p, fn _ -> length(heard([])) end) end)
    assert {:ok, _count} = Enum.find(counts, &(&1 != {:ok, 0}))
    {:ok, _} = Pipeline.stop(p)
  end

  test "an error names a component whose state cannot be saved" do
    build = fn p -> p |> Situ.timer(every: Time.ms(1)) |> Situ.via(Echo, name: "Echo") end
    {:ok, p} = Pipeline.start(build, [])
    assert {:error, error} = Pipeline.checkpoint(p, & &1)
    assert error.code == :no_snapshot
    assert error.meta.component == "Echo"
    # The sources keep running.
    me = self()
    {:ok, _} = Situ.attach_tap({p, "Echo"}, fn m -> send(me, {:tap, m.data}) end)
    assert_receive {:tap, _}, 30_000
    {:ok, _} = Pipeline.stop(p)
  end

  test "sources continue when the caller of a checkpoint ends" do
    me = self()
    build = fn p -> p |> Situ.timer(every: Time.ms(1)) |> Situ.each(&send(me, {:tick, &1})) end
    {:ok, p} = Pipeline.start(build, [])

    holder =
      spawn(fn ->
        Pipeline.checkpoint(p, fn _ ->
          send(me, :held)
          Process.sleep(:infinity)
        end)
      end)

    assert_receive :held, 30_000
    ticks(0)
    refute_receive {:tick, _}, 30
    Process.exit(holder, :kill)
    assert_receive {:tick, _}, 30_000
    {:ok, _} = Pipeline.stop(p)
  end

  test "a source that is paused for a checkpoint can be tapped, extended and replaced" do
    me = self()

    build = fn p ->
      p
      |> Situ.source(Steps, k: 1, name: "Steps", on_same_time: :nudge)
      |> Situ.each(&send(me, {:old, &1}))
    end

    {:ok, p} = Pipeline.start(build, [])

    {:ok, memories} =
      Pipeline.checkpoint(p, fn memories ->
        {:ok, _} = Situ.attach_tap({p, "Steps"}, fn m -> send(me, {:tap, m.data}) end)
        :ok = Pipeline.replace(p, "Steps", k: 2)

        {:ok, _} =
          Pipeline.extend(p, fn p ->
            p |> Pipeline.stream("Steps") |> Situ.each(&send(me, {:new, &1}))
          end)

        {:ok, old} = Situ.attach_tap({p, "Steps"}, fn m -> send(me, {:gone, m.data}) end)
        :ok = Situ.detach_tap(old)
        refute_received {:tap, _}
        refute_received {:new, _}
        memories
      end)

    assert %{core: core} = memories["Steps"]
    assert inspect(core) =~ "1"

    # Every consumer received the new source's first message, and none received one of the old source.
    for name <- [:tap, :new] do
      assert_receive {^name, first}, 30_000
      assert first == {:first, 2}
      assert_receive {^name, 2}, 30_000
    end

    {:ok, _} = Pipeline.stop(p)
    refute_received {:gone, _}
    refute_received {:tap, 1}
    refute_received {:new, 1}
  end

  defp ticks(_), do: receive(do: ({:tick, _} -> ticks(0)), after: (0 -> :ok))
end
