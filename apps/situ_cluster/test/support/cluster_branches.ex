defmodule Situ.Test.ClusterBranches do
  @moduledoc false
  # Runs a parallel operator whose branches are on the nodes of a cluster. All functions are called on one of them.
  alias Situ.{Cluster, Test}

  @doc "Makes the node a member, and waits until it knows `count` members."
  def join(log, labels, others, count) do
    {:ok, _} = Application.ensure_all_started(:situ_cluster)
    {:ok, _} = Cluster.join(log: log, labels: labels)
    for node <- others, do: true = Node.connect(node)
    await_members(count)
  end

  defp await_members(count) do
    if map_size(Cluster.Agent.info().members) < count, do: await_members(count), else: :ok
  end

  @doc "Sums the parts of each key, with the node that has done it."
  def sum(maps, rule, opts) do
    Test.run([m: maps], fn s ->
      Situ.parallel(s.m, fn _key, part -> part |> Situ.sum() |> Situ.map(&{&1, node()}) end, [
        {:branches, {:nodes, &Cluster.choose_node(&1, rule)}} | opts
      ])
    end)
  end

  @doc """
  Sums endless ones on two nodes and ends `other` after the first output. Returns when the branch that was there runs
  here, with the pipeline's result and the sums of that branch, newest first.
  """
  def lose_node(other, opts) do
    restarted = :atomics.new(1, [])
    ones = Stream.repeatedly(fn -> %{here: 1, there: 1} end)
    place = fn key -> if key == :there and other in Node.list(), do: other, else: node() end

    result =
      Situ.collect(
        fn p ->
          p
          |> Situ.from_enumerable(
            Stream.take_while(ones, fn _ -> :atomics.get(restarted, 1) == 0 end),
            every: 1_000
          )
          |> Situ.parallel(
            fn _key, part -> part |> Situ.sum() |> Situ.map(&{&1, node()}) end,
            [branches: {:nodes, place}, or_default: nil] ++ opts
          )
          |> Situ.map(&Map.get(&1, :there))
          |> Situ.each(&end_or_note(&1, other, restarted))
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    with {:ok, messages} <- result, do: {:ok, messages |> Enum.map(& &1.data) |> Enum.reverse()}
  end

  defp end_or_note({1, other}, other, _restarted), do: :erpc.cast(other, :erlang, :halt, [0])

  defp end_or_note({_sum, node}, _other, restarted) when node == node(),
    do: :atomics.put(restarted, 1, 1)

  defp end_or_note(_other_output, _other, _restarted), do: :ok
end
