defmodule Situ.Ports.InputsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Delivery, Message}
  alias Situ.Ports.{Counters, Input, Inputs}

  defp input(tag) do
    extra = %{type: :any, check: :off, counters: Counters.new(), sizes: false}
    Input.new(:in, tag, self(), Delivery.unlimited(window: 2), extra)
  end

  defp inputs(n), do: Inputs.new(for tag <- 1..n, do: input(tag))

  defp message(time) do
    %Message{
      data: time,
      originating_time: time,
      creation_time: time,
      sequence_id: 0,
      source_id: 1
    }
  end

  defp push(inputs, tag, time) do
    case inputs.by_tag do
      %{^tag => input} -> Inputs.put(inputs, Input.push(input, [[message(time)]]))
      _has_closed -> inputs
    end
  end

  defp step({:push, tag, time}, inputs), do: push(inputs, tag, time)
  defp step({:delete, tag}, inputs), do: Inputs.delete(inputs, tag)
  defp step({:add, tag}, inputs), do: Inputs.put(inputs, input(tag))
  defp step(:settle, inputs), do: Inputs.settle_touched(inputs, {1, 1})
  defp step({:hold, tag, held?}, inputs), do: hold(inputs, inputs.by_tag[tag], held?)

  defp step(:take, inputs) do
    case Inputs.earliest_input(inputs) do
      nil ->
        inputs

      input ->
        {%{originating_time: time}, input} = Input.pop(input, 0)
        Inputs.put(inputs, Input.count_handled(input, 1, time, time))
    end
  end

  defp hold(inputs, nil, _held?), do: inputs
  defp hold(inputs, input, held?), do: Inputs.put(inputs, Input.set_hold(input, held?))

  # Decodes numbers into steps; most steps push or take messages.
  defp decoded({kind, tag, time}) when kind < 8, do: {:push, tag, time}
  defp decoded({kind, _tag, _time}) when kind < 16, do: :take
  defp decoded({kind, _tag, _time}) when kind < 18, do: :settle
  defp decoded({18, tag, time}), do: {:hold, tag, rem(time, 2) == 0}
  defp decoded({19, tag, _time}), do: {:delete, tag}
  defp decoded({20, tag, _time}), do: {:add, 24 + rem(tag, 6)}

  property "the input with the oldest message is next, and settling settles every input" do
    forall {n, steps} <- {integer(1, 24), list({integer(0, 20), integer(1, 24), integer(0, 99)})} do
      inputs = Enum.reduce(steps, inputs(n), &step(decoded(&1), &2))
      heads = for {_, input} <- inputs.by_tag, do: Input.head_time(input)
      oldest = heads |> Enum.reject(&(&1 == :none)) |> Enum.min(fn -> nil end)
      next = Inputs.earliest_input(inputs)
      settled = Inputs.settle_touched(inputs, {1, 1}).by_tag

      assert (next && Input.head_time(next)) == oldest

      assert Enum.all?(settled, fn {_, input} ->
               match?(%{handled: {0, 0, 0, 0}, window: %{owed: 0}}, input)
             end)
    end
  end

  # Measures the cost of one message: taken from its input, counted and requested again. The heap is so large that no
  # garbage is collected, which would count as reductions.
  defp work(n) do
    me = self()
    spawn_opt = [:link, min_heap_size: 4_000_000]
    :erlang.spawn_opt(fn -> send(me, {:work, measure_work(n)}) end, spawn_opt)
    assert_receive {:work, reductions}, 60_000
    reductions
  end

  defp measure_work(n) do
    inputs = for tag <- 1..n, reduce: inputs(n), do: (inputs -> push(inputs, tag, tag))
    inputs = Inputs.settle_touched(inputs, {1, 1})
    {:reductions, before} = Process.info(self(), :reductions)

    for _ <- 1..100, reduce: inputs do
      inputs ->
        inputs = step(:take, inputs)
        Inputs.settle_touched(inputs, {1, 1})
    end

    {:reductions, later} = Process.info(self(), :reductions)
    later - before
  end

  test "the cost of a message does not grow with four thousand inputs" do
    few = work(100)
    assert work(4_000) < 4 * few
  end

  property "messages in progress are published when they are finished, and requested once" do
    forall {count, steps} <- {integer(1, 20), list({integer(0, 20), integer(0, 1)})} do
      inputs = Enum.reduce(1..count, inputs(1), &push(&2, 1, &1))
      inputs = Enum.reduce(1..count, inputs, fn _, inputs -> step(:take, inputs) end)

      inputs =
        Enum.reduce(steps, inputs, fn {in_progress, settle?}, inputs ->
          finished = count - min(in_progress, count)
          inputs = Inputs.put_progress(inputs, :in, {in_progress, finished})
          if settle? == 1, do: step(:settle, inputs), else: inputs
        end)

      least =
        steps
        |> Enum.filter(&(elem(&1, 1) == 1))
        |> Enum.map(&elem(&1, 0))
        |> Enum.min(fn -> count end)

      %{counters: counters} = Inputs.single_input(inputs)
      # What is published once remains published.
      assert Input.taken_count(Inputs.single_input(inputs)) == max(count - least, 0)

      done =
        inputs |> Inputs.forget_progress() |> then(&step(:settle, &1)) |> Inputs.single_input()

      assert Input.taken_count(done) == count
      assert Counters.last_time(counters) == count
      assert Enum.sum(requests()) + done.window.owed == count
    end
  end

  defp requests do
    receive do
      {:"$gen_producer", _from, {:ask, n}} -> [n | requests()]
    after
      0 -> []
    end
  end
end
