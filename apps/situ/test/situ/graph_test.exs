defmodule Situ.GraphTest do
  use ExUnit.Case, async: true

  alias Situ.Graph
  alias Situ.Graph.Plan

  # Measures the cost of building and planning in VM reductions, since wall time would include other work on the
  # machine.
  defp cost(fun) do
    me = self()

    spawn_link(fn ->
      {:reductions, before} = Process.info(self(), :reductions)
      fun.()
      {:reductions, later} = Process.info(self(), :reductions)
      send(me, {:cost, later - before})
    end)

    receive do: ({:cost, n} -> n)
  end

  defp fan(n) do
    fn p ->
      source = Situ.from_enumerable(p, [{1, 1}])
      for _ <- 1..n, do: source |> Situ.map(& &1, async: true) |> Situ.each(& &1, async: true)
    end
  end

  defp chain(n) do
    fn p ->
      source = Situ.from_enumerable(p, [{1, 1}])
      Enum.reduce(1..n, source, fn _, s -> Situ.map(s, & &1, async: true) end)
    end
  end

  test "building and planning take time linear in the number of components" do
    for shape <- [&fan/1, &chain/1] do
      [small, large] =
        for n <- [500, 2_000] do
          cost(fn ->
            {graph, _} = Graph.build(shape.(n))
            assert {:ok, %Plan{}} = Plan.compile(graph)
          end)
        end

      # With four times as many components, trees get slightly deeper; quadratic work would cost sixteen times as
      # much.
      assert large < 10 * small
    end
  end

  test "only edges on a cycle are unbounded" do
    {graph, _} =
      Graph.build(fn p ->
        one = Situ.Pipeline.add(p, Situ.Fixture.Pass, name: "One")
        two = Situ.Pipeline.add(p, Situ.Fixture.Pass, name: "Two")
        three = Situ.Pipeline.add(p, Situ.Fixture.Pass, name: "Three")
        Situ.Pipeline.connect(Situ.Node.output(one, :out), two, :in)
        Situ.Pipeline.connect(Situ.Node.output(two, :out), one, :in)
        Situ.Pipeline.connect(Situ.Node.output(two, :out), three, :in)
      end)

    {:ok, plan} = Plan.compile(graph)
    windows = Map.new(plan.edges, &{&1.id, &1.policy.window})
    assert windows == %{1 => :infinity, 2 => :infinity, 3 => 1_000}
  end

  # Returns the paths of the components in each process.
  defp processes(opts) do
    {graph, _} =
      Graph.build(fn p ->
        p
        |> Situ.from_enumerable([{1, 1}], name: "Source")
        |> Situ.map(& &1, [name: "One"] ++ opts)
        |> Situ.map(& &1, [name: "Two"] ++ opts)
      end)

    {:ok, plan} = Plan.compile(graph)
    for stage <- plan.stages, do: Enum.map(stage.vertices, & &1.path)
  end

  test "a source that cannot wait has its own process, unless its consumer is synchronous" do
    alias Situ.Delivery

    for {policy, stages} <- [
          {Delivery.throttle(1), [["Ticks"], ["One"]]},
          {Delivery.synchronous(), [["Ticks", "One"]]}
        ] do
      {graph, _} =
        Graph.build(fn p ->
          p |> Situ.timer(every: 1, name: "Ticks") |> Situ.map(& &1, name: "One", policy: policy)
        end)

      {:ok, plan} = Plan.compile(graph)
      assert stages == for(s <- plan.stages, do: Enum.map(s.vertices, & &1.path))
    end
  end

  test "no operator joins the process of a component with async: true" do
    for opts <- [[], [policy: Situ.Delivery.throttle(1)]] do
      {graph, _} =
        Graph.build(fn p ->
          p
          |> Situ.source(Situ.Fixture.Count, name: "Source", async: true)
          |> Situ.map(& &1, [name: "One"] ++ opts)
        end)

      {:ok, plan} = Plan.compile(graph)
      assert [["Source"], ["One"]] == for(s <- plan.stages, do: Enum.map(s.vertices, & &1.path))
    end
  end

  test "operators with throttle(1) share a process, unless they are async" do
    alias Situ.Delivery
    assert processes(policy: Delivery.throttle(1)) == [["Source", "One", "Two"]]
    assert processes(policy: Delivery.throttle(2)) == [["Source"], ["One"], ["Two"]]

    assert processes(policy: Delivery.throttle(1), async: true) ==
             [["Source"], ["One"], ["Two"]]

    assert processes(policy: Delivery.unlimited()) == [["Source"], ["One"], ["Two"]]
  end
end
