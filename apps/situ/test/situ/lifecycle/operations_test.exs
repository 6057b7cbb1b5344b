defmodule Situ.Lifecycle.OperationsTest do
  # The log of changes: which operations wait for which, and how each of them ends.
  use ExUnit.Case, async: true

  alias Situ.{Error, Lifecycle, Pipeline, Time}
  alias Situ.Fixture.Count
  alias Situ.Lifecycle.Operations
  alias Situ.Lifecycle.State

  import Situ.Test.Eventually

  @moduletag :capture_log

  defp scope(reads, writes), do: %{what: {:test, nil}, reads: [:graph | reads], writes: writes}
  defp whole, do: %{what: {:checkpoint, nil}, reads: [], writes: [:graph]}

  # Applies the events and returns the ids of the operations that begin, the answers, and the state.
  defp apply_events(state \\ %State{phase: :running, step: :running}, events) do
    {state, actions} =
      Enum.reduce(events, {state, []}, fn event, {state, actions} ->
        {state, more} = Lifecycle.apply_event(state, event, 1)
        {state, actions ++ more}
      end)

    begun = for {:perform, id, _request, _from} <- actions, do: id
    {begun, for({:reply, from, answer} <- actions, do: {from, answer}), state}
  end

  defp accept(scope, from \\ nil), do: {:accept, :request, scope, from}

  test "operations on the same stage run in order, others concurrently" do
    events = [accept(scope([], [1])), accept(scope([], [1])), accept(scope([], [2]))]
    {begun, [], state} = apply_events(events)
    assert begun == [1, 3]
    {begun, [], _state} = apply_events(state, [{:finished, 1, :ok}])
    assert begun == [2]
  end

  test "operations that only read a stage run concurrently" do
    events = [accept(scope([1], [])), accept(scope([1], [])), accept(scope([], [1]))]
    {begun, _, state} = apply_events(events)
    assert begun == [1, 2]
    assert {[], [], state} = apply_events(state, [{:finished, 2, :ok}])
    assert {[3], [], _} = apply_events(state, [{:finished, 1, :ok}])
  end

  test "an operation on the whole graph waits for the earlier ones, and later ones for it" do
    events = [accept(scope([], [1])), accept(whole()), accept(scope([], [2]))]
    {[1], _, state} = apply_events(events)
    {[2], _, state} = apply_events(state, [{:finished, 1, :ok}])
    # It continues, and touches only one key.
    assert {[3], [], _} = apply_events(state, [{:answered, 2, {:ok, :snapshots}, [:checkpoint]}])
  end

  test "the caller receives the answer, and the log shows how the operation ended" do
    error = Error.new(:not_running, "no")
    events = [accept(scope([], [1]), {:a, 1}), accept(scope([], [1]), {:b, 2})]
    {_, [], state} = apply_events(events)
    {_, answers, state} = apply_events(state, [{:finished, 1, {:error, error}}])
    assert answers == [{{:a, 1}, {:error, error}}]
    assert [%{id: 2, state: :running}, %{id: 1}] = Operations.list(state.operations)
    assert {[], [{{:b, 2}, :ok}], state} = apply_events(state, [{:finished, 2, :ok}])
    assert [%{state: :applied}, %{state: {:refused, ^error}}] = Operations.list(state.operations)
    assert %{open: open, keys: keys, waiting: []} = state.operations
    assert {open, keys} == {%{}, %{}}
  end

  test "a timeout refuses an operation that waits, and answers the caller of a running one" do
    error = Error.new(:timeout, "late")
    events = [accept(scope([], [1]), {:a, 1}), accept(scope([], [1]), {:b, 2})]
    {_, _, state} = apply_events(events)
    {[], answers, state} = apply_events(state, [{:expired, 2, error}, {:expired, 1, error}])
    assert answers == [{{:b, 2}, {:error, error}}, {{:a, 1}, {:error, error}}]
    assert [%{state: {:refused, _}}, %{state: :running}] = Operations.list(state.operations)
    assert {[], [], _} = apply_events(state, [{:finished, 1, :ok}])
  end

  test "the end of the pipeline refuses the operations that wait" do
    events = [accept(scope([], [1])), accept(scope([], [1]), :b), accept(whole(), :c)]
    {_, _, state} = apply_events(events)
    {begun, answers, _state} = apply_events(state, [{:stop, 0}])
    assert begun == []

    assert [{:b, {:error, %{code: :not_running}}}, {:c, {:error, %{code: :not_running}}}] =
             answers
  end

  # A pipeline with a part whose sink waits for `:go` at its first message.
  defp start do
    me = self()

    {:ok, p} =
      Pipeline.start(fn p ->
        numbers = Situ.source(p, Count, count: :infinity, interval: Time.ms(1), name: "Count")

        Situ.composite(numbers, "Side", fn numbers ->
          Situ.each(numbers, &wait(me, &1), async: true)
        end)
      end)

    assert_receive {:side, side}
    {p, side}
  end

  defp wait(test, number) do
    if number == 0, do: send(test, {:side, self()}) && receive(do: (:go -> :ok))
  end

  defp request(p, waiting, fun) do
    task = Task.async(fun)
    assert eventually(fn -> length(Pipeline.list_changes(p)) == waiting end)
    task
  end

  test "a checkpoint waits for a part that is being stopped" do
    {p, side} = start()
    stop = request(p, 1, fn -> Pipeline.stop_part(p, "Side") end)
    checkpoint = request(p, 2, fn -> Pipeline.checkpoint(p, &map_size/1) end)
    extend = request(p, 3, fn -> Pipeline.extend(p, &Situ.from_enumerable(&1, [1], every: 1)) end)
    assert [:waiting, :waiting, :running] = for(c <- Pipeline.list_changes(p), do: c.state)
    send(side, :go)
    assert :ok = Task.await(stop)
    assert {:error, %{code: :not_running}} = Task.await(checkpoint)
    assert {:ok, _} = Task.await(extend)
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "checkpoints take turns, and one inside another is refused" do
    {:ok, p} = Pipeline.start(&Situ.source(&1, Count, count: :infinity, interval: Time.ms(1)))
    me = self()

    first =
      Task.async(fn ->
        Pipeline.checkpoint(p, fn _ ->
          send(me, :held)
          receive do: (:go -> :ok)
          Pipeline.checkpoint(p, & &1)
        end)
      end)

    assert_receive :held
    # Other changes do not wait for the caller.
    assert {:ok, _} = Pipeline.extend(p, &Situ.timer(&1, every: Time.ms(1)))
    second = request(p, 3, fn -> Pipeline.checkpoint(p, fn _ -> :second end) end)
    send(first.pid, :go)
    assert {:ok, {:error, %{code: :busy}}} = Task.await(first)
    assert {:ok, :second} = Task.await(second)
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "the change of a caller that ends while it waits is not made" do
    {p, side} = start()
    stop = request(p, 1, fn -> Pipeline.stop_part(p, "Side") end)
    caller = spawn(fn -> Pipeline.start_part(p, "Side") end)
    assert eventually(fn -> length(Pipeline.list_changes(p)) == 2 end)
    Process.exit(caller, :kill)
    later = request(p, 3, fn -> Pipeline.remove(p, "Side") end)
    send(side, :go)
    assert :ok = Task.await(stop)
    assert :ok = Task.await(later)
    assert [_, %{state: {:refused, %{code: :caller_ended}}}, _] = Pipeline.list_changes(p)
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "a stop of the pipeline answers every caller" do
    {p, side} = start()
    stop = request(p, 1, fn -> Pipeline.stop_part(p, "Side") end)
    start = request(p, 2, fn -> Pipeline.start_part(p, "Side") end)
    pause = request(p, 3, fn -> Pipeline.pause(p) end)
    whole = Task.async(fn -> Pipeline.stop(p) end)
    assert {:error, %{code: :not_running}} = Task.await(start)
    assert {:error, %{code: :not_running}} = Task.await(pause)
    send(side, :go)
    assert :ok = Task.await(stop)
    assert {:ok, _} = Task.await(whole)
  end
end
