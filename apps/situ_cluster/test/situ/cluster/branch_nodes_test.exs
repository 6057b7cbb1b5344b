defmodule Situ.Cluster.BranchNodesTest do
  # Runs the branches of a parallel operator on two nodes: virtual machines of this test, connected by distribution.
  use ExUnit.Case, async: true

  alias Situ.Cluster.Placement
  alias Situ.Test.ClusterBranches

  @moduletag :tmp_dir
  @moduletag :capture_log

  # The nodes find each other by the ports in their names, so no daemon is needed.
  defp start_node(label) do
    {:ok, socket} = :gen_tcp.listen(0, reuseaddr: true)
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)

    {:ok, peer, node} =
      :peer.start_link(%{
        name: ~c"#{label}-#{port}",
        host: ~c"127.0.0.1",
        longnames: true,
        connection: :standard_io,
        args:
          [~c"-start_epmd", ~c"false", ~c"-epmd_module", ~c"Elixir.Situ.Cluster.Epmd"] ++
            [~c"-setcookie", ~c"branches", ~c"-pa" | :code.get_path()]
      })

    {peer, node}
  end

  defp start_cluster(%{tmp_dir: folder}) do
    nodes = [{_, a}, {_, b}] = [start_node("left"), start_node("right")]

    [nodes, ["left", "right"], [[b], [a]]]
    |> Enum.zip()
    |> Enum.map(fn {{peer, _node}, label, others} ->
      Task.async(fn -> call(peer, :join, [folder, [label], others, 2]) end)
    end)
    |> Task.await_many(60_000)

    nodes
  end

  defp call(peer, function, args), do: :peer.call(peer, ClusterBranches, function, args, 60_000)

  test "branches run on the nodes of a rule, with the same outputs as here", context do
    [{here, a}, {_there, b}] = start_cluster(context)
    maps = for t <- 0..99, do: {t, Map.new(0..rem(t, 8), &{&1, t + &1})}

    {:ok, outputs} = call(here, :sum, [maps, [], []])
    {:ok, expected} = Situ.Test.run([m: maps], &Situ.parallel(&1.m, fn _, s -> Situ.sum(s) end))
    strip = fn map -> Map.new(map, fn {key, {sum, _node}} -> {key, sum} end) end
    assert for({time, map} <- outputs, do: {time, strip.(map)}) == expected
    assert outputs |> nodes_of() |> Enum.sort() == Enum.sort([a, b])

    {:ok, outputs} = call(here, :sum, [maps, [on: "right"], []])
    assert nodes_of(outputs) == [b]
    assert {:error, %{code: :no_node}} = call(here, :sum, [maps, [on: "gpu", only: true], []])
  end

  defp nodes_of(outputs),
    do: for({_, map} <- outputs, {_, {_, node}} <- map, uniq: true, do: node)

  test "the branches of a lost node restart elsewhere", context do
    [{here, a}, {_there, b}] = start_cluster(context)
    {:ok, sums} = call(here, :lose_node, [b, [on_branch_error: :restart]])
    assert {_sum, ^a} = hd(sums)
    assert {1, b} == List.last(sums)
    assert {1, a} in sums
  end

  test "a lost node fails the operator with an error that names the branch", context do
    [{here, _a}, {_there, b}] = start_cluster(context)
    assert {:error, error} = call(here, :lose_node, [b, []])
    assert error.code == :branch_killed
    assert error.what =~ "Parallel[:there]"
    assert error.what =~ "noconnection"
  end

  test "only the keys of a lost node move" do
    members = Map.new([:a, :b, :c], &{&1, Placement.build_member(%{labels: ["gpu"]})})
    rule = %{on: ["gpu"], only: false}

    choose = fn members ->
      Map.new(1..300, &{&1, Placement.choose_branch_node(members, rule, &1)})
    end

    before = choose.(members)
    later = choose.(Map.delete(members, :b))
    for node <- [:a, :b, :c], do: assert(Enum.count(before, &(elem(&1, 1) == node)) in 60..140)
    for {key, node} <- before, node != :b, do: assert(later[key] == node)
    for {key, :b} <- before, do: assert(later[key] in [:a, :c])
    assert Placement.choose_branch_node(members, %{on: ["camera"], only: true}, 1) == nil
  end
end
