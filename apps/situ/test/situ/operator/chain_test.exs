defmodule Situ.Operator.ChainTest do
  # A chain that runs a batch gives the same results as its operators one message after another.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Graph.Vertex
  alias Situ.{Columns, Message}
  alias Situ.Operator.Chain
  require Chain

  defp vertex(step), do: %Vertex{id: 1, module: :operator, path: "P", opts: step}
  defp chain(steps), do: steps |> Enum.map(&vertex/1) |> Chain.compile(0)

  # Operators raise at data that is a multiple of 13.
  defp step(0), do: {:map, &check(&1 + 1)}
  defp step(1), do: {:map, fn data, message -> check(data + message.sequence_id) end}
  defp step(2), do: {:filter, &(rem(check(&1), 3) != 0)}
  defp step(3), do: {:filter, fn data, message -> data > message.originating_time - 50 end}
  defp step(4), do: {:each, &check/1}
  defp step(5), do: {:step, fn data, _m, sum -> {:emit, check(data) + sum, sum + 1} end, 0}

  defp step(6),
    do:
      {:step,
       fn data, _m, n -> if(rem(n, 2) == 0, do: {:emit, data, n + 1}, else: {:skip, n + 1}) end,
       0}

  defp check(data), do: if(rem(data, 13) == 0, do: raise("thirteen"), else: data)

  defp messages(values) do
    for {value, i} <- Enum.with_index(values, 1),
        do: %Message{data: value, originating_time: i * 10, sequence_id: i}
  end

  # The reference: each message alone, up to the first failure.
  defp reference(chain, messages) do
    Enum.reduce_while(messages, {[], chain.steps, :done}, fn message, {results, steps, :done} ->
      try do
        {result, steps} = Chain.run_stateful(steps, message.data, message)
        {:cont, {[result | results], steps, :done}}
      catch
        {:situ_step, index, kind, reason, _stack} ->
          {:halt, {results, steps, {index, kind, reason}}}
      end
    end)
    |> then(fn {results, steps, outcome} -> {Enum.reverse(results), steps, outcome} end)
  end

  defp outcome({:situ_step, index, kind, reason, _stack}), do: {index, kind, reason}
  defp outcome(other), do: other

  property "a batch gives the results, states and failures of its messages one by one" do
    forall {kinds, values} <- {list(integer(0, 6)), list(integer(1, 99))} do
      chain = kinds |> Enum.map(&step/1) |> chain()
      messages = messages(values)

      if messages != [] do
        {expected, steps, failure} = reference(chain, messages)
        {results, ran, outcome} = Chain.run_batch(chain, messages, :never)
        assert results == expected
        assert outcome(outcome) == failure
        assert Enum.map(ran.steps, &Tuple.to_list/1) == Enum.map(steps, &Tuple.to_list/1)
      end
    end
  end

  test "the time is checked after four messages, with and without state" do
    for steps <- [[step(0)], [step(1)], [step(5)]] do
      assert {[_, _, _, _], _chain, :late} =
               Chain.run_batch(
                 chain(steps),
                 messages([1, 2, 3, 4, 5, 6]),
                 :erlang.monotonic_time(:nanosecond) - 1
               )
    end
  end

  test "a failure names the operator by its index" do
    chain = [{:map, & &1}, {:map, fn _ -> throw(:ball) end}, {:map, & &1}] |> chain()

    assert {[], _, {:situ_step, 1, :throw, :ball, _}} =
             Chain.run_batch(chain, messages([1]), :never)
  end

  test "columns give the results of their messages, also where an operator fails" do
    chains = [
      [{:map, &refuse_zero/1}],
      [{:map, &refuse_zero/1}, {:filter, fn data, message -> data > message.sequence_id end}],
      [{:step, fn data, _message, sum -> {:emit, refuse_zero(data) + sum, sum + 1} end, 0}]
    ]

    for steps <- chains, failing <- [1, 256, 257, 700, nil] do
      messages =
        messages(for i <- 1..700, do: if(i == failing, do: 0, else: rem(i * 997, 1_400) + 1))

      {:ok, columns} = Columns.from_messages(messages)
      {expected, ran, expected_outcome} = Chain.run_batch(chain(steps), messages, :never)
      {results, again, outcome} = Chain.run_batch(chain(steps), columns, :never)
      assert results == expected
      assert outcome(outcome) == outcome(expected_outcome)
      assert outcome == :done == (failing == nil)
      assert Enum.map(again.steps, &Tuple.to_list/1) == Enum.map(ran.steps, &Tuple.to_list/1)
    end
  end

  test "a chain that runs out of time unpacks few of many columns" do
    {:ok, columns} = Columns.from_messages(messages(for i <- 1..100_000, do: 26 * i))
    past = :erlang.monotonic_time(:nanosecond) - 1

    for step <- [step(0), step(3)] do
      chain = chain([step])
      {:reductions, before} = Process.info(self(), :reductions)

      assert {[_, _, _, _], _chain, :late} = Chain.run_batch(chain, columns, past)

      {:reductions, later} = Process.info(self(), :reductions)
      assert later - before < 10_000
    end
  end

  defp refuse_zero(0), do: raise("zero")
  defp refuse_zero(data), do: data
end
