defmodule Situ.Delivery.QueueTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Delivery.Queue

  alias Situ.{Delivery, Message}
  alias Situ.Delivery.Queue

  defp message(t), do: %Message{data: t, originating_time: t}

  # A reference implementation of a bounded queue, on a plain list.
  defmodule Model do
    def push(waiting, max, keep?, m) do
      n = length(waiting)
      victim = Enum.find_index(waiting, &(not keep?.(&1.data)))

      cond do
        n < max -> {waiting ++ [m], []}
        n == max and victim != nil -> drop(waiting, victim, m)
        keep?.(m.data) -> {waiting ++ [m], []}
        true -> {waiting, [m]}
      end
    end

    defp drop(waiting, victim, m) do
      {lost, rest} = List.pop_at(waiting, victim)
      {rest ++ [m], [lost]}
    end
  end

  property "pushes and pops follow the reference model, with and without a guarantee" do
    forall {max, modulo, steps} <- {integer(1, 5), integer(0, 3), list(integer(0, 3))} do
      keep? = if modulo == 0, do: fn _ -> false end, else: &(rem(&1, modulo + 1) == 0)
      opts = if modulo == 0, do: [], else: [guarantee: keep?]
      start = {Queue.new(Delivery.max_queue(max, opts)), [], 0}

      Enum.reduce(steps, start, fn
        3, {queue, waiting, n} ->
          {entry, queue, []} = Queue.pop(queue, n)
          assert entry == List.first(waiting)
          {queue, Enum.drop(waiting, 1), n}

        _, {queue, waiting, n} ->
          {waiting, lost} = Model.push(waiting, max, keep?, message(n))
          assert {queue, ^lost} = Queue.push(queue, message(n))
          assert Queue.to_list(queue) == waiting
          assert Queue.peek(queue) == List.first(waiting)
          assert queue.size == length(waiting)
          {queue, waiting, n + 1}
      end)
    end
  end

  # Counts reductions, since wall time varies on a busy machine.
  defp cost(fun) do
    {:reductions, before} = Process.info(self(), :reductions)
    fun.()
    {:reductions, later} = Process.info(self(), :reductions)
    later - before
  end

  defp cost_of_a_push(max, opts) do
    full = Enum.reduce(1..max, Queue.new(Delivery.max_queue(max, opts)), &push/2)
    n = 20_000
    cost(fn -> Enum.reduce((max + 1)..(max + n), full, &push/2) end) / n
  end

  defp push(t, queue), do: queue |> Queue.push(message(t)) |> elem(0)

  test "the cost of a push into a full queue does not depend on the queue's size" do
    for opts <- [[], [guarantee: &(rem(&1, 2) == 0)], [guarantee: &(rem(&1, 100) == 0)]] do
      assert cost_of_a_push(10_000, opts) < 4 * cost_of_a_push(10, opts) + 20
    end
  end

  test "expires old messages from the front and keeps protected ones" do
    policy = Delivery.max_latency(10, guarantee: &(&1 == 1))
    queue = Enum.reduce(1..30, Queue.new(policy), &push/2)
    assert {^queue, []} = Queue.drop_expired(queue, 30)
    queue = elem(Queue.take(queue, 1), 2)
    {queue, lost} = Queue.drop_expired(queue, 30)
    assert Enum.map(lost, & &1.data) == Enum.to_list(2..19)
    assert Queue.peek(queue).data == 20
  end

  test "closing drops messages after the closing time only from the front" do
    queue = Enum.reduce(1..5, Queue.new(Delivery.max_queue(5)), &push/2)
    assert {rest, late} = Queue.drop_after(queue, 0)
    assert {[], 5} = {Queue.to_list(rest), length(late)}
    assert {_, []} = Queue.drop_after(queue, 3)
  end
end
