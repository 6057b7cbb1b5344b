defmodule Situ.Lifecycle.RestartGroupTest do
  # Composites with their own policy and `on_error:`.
  use ExUnit.Case, async: true

  alias Situ.{Delivery, Pipeline, Time}
  alias Situ.Fixture.{Closing, Count}

  @moduletag :capture_log

  defmodule Summing do
    # Sums up its input; the second instance raises at seven.
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [to: [type: :pid, required: true], as: [type: :atom, default: :sum]]

    @impl true
    def init(opts), do: {:ok, {opts[:to], opts[:as], 0}}

    @impl true
    def handle_start(_context, {to, as, 0} = state) do
      send(to, {:started, as, self()})
      {[], state}
    end

    @impl true
    def handle_message(:in, %{data: 7}, _context, {_to, :sum, _}), do: raise("seven")

    def handle_message(:in, m, _context, {to, as, sum}),
      do: {[{:out, m.originating_time, sum + m.data}], {to, as, sum + m.data}}

    @impl true
    def terminate(_reason, {to, as, sum}), do: send(to, {:terminated, as, sum})
  end

  defp start(on_error, opts \\ []) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          count = Situ.source(p, Count, count: :infinity, interval: Time.ms(1))
          Situ.each(count, &send(me, {:main, &1}), async: true, name: "Main")

          count
          |> Situ.composite(
            "Unit",
            fn count ->
              first = Situ.via(count, Summing, to: me, as: :first, name: "First")
              second = Situ.via(count, Summing, to: me, name: "Second")
              second |> Situ.zip(first) |> Situ.map(&Enum.sum/1)
            end,
            on_error: on_error
          )
          |> Situ.each(&send(me, {:out, &1}), async: true)
          |> Situ.via(Closing, to: me)
        end,
        pipeline: opts
      )

    for as <- [:first, :sum], do: assert_receive({:started, ^as, _})
    p
  end

  defp pid(p, path), do: for({^path, pid, _, _} <- Supervisor.which_children(p), do: pid) |> hd()

  test "restarts as a unit with fresh state while the rest keeps running" do
    p = start(:restart)
    # Both terminate because one of them raised.
    for as <- [:first, :sum], do: assert_receive({:terminated, ^as, _}, 5_000)
    for as <- [:first, :sum], do: assert_receive({:started, ^as, _}, 5_000)
    assert_receive {:out, _}
    assert_receive {:main, 20}
    assert Pipeline.state(p) == :running
    assert {:ok, report} = Pipeline.stop(p)
    assert report.errors == []
    for name <- ~w(Unit.First Unit.Second), do: assert(name in report.closed)
  end

  test "restarts if one of its components is killed" do
    p = start(:restart)
    for as <- [:first, :sum], do: assert_receive({:terminated, ^as, _}, 5_000)
    for as <- [:first, :sum], do: assert_receive({:started, ^as, _}, 5_000)
    assert Pipeline.clock(p)
    Process.exit(pid(p, "Unit.First"), :kill)
    # The killed component could not run terminate/2.
    assert_receive {:terminated, :sum, _}, 5_000
    for as <- [:first, :sum], do: assert_receive({:started, ^as, _}, 5_000)
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "fails the pipeline when it exceeds max_restarts" do
    p = start(:restart, max_restarts: 0)
    assert {:error, %{code: :restarted_too_often, meta: meta}} = Pipeline.await(p, 30_000)
    assert meta.component == "Unit"
  end

  test "with :close ends as a unit: its outputs close and the rest keeps running" do
    p = start(:close)
    for as <- [:first, :sum], do: assert_receive({:terminated, ^as, _}, 5_000)
    assert_receive {:closed, :in, _}
    assert_receive {:main, n} when n > 10
    assert Pipeline.state(p) == :running
    assert {:ok, %{errors: []} = report} = Pipeline.stop(p)
    assert "Unit.First" in report.closed
  end

  test "with :stop, an error inside ends the pipeline" do
    p = start(:stop)
    assert {:error, %{code: :component_failed}} = Pipeline.await(p, 30_000)
  end

  test "a pipeline that is stopped while a unit restarts ends" do
    for _ <- 1..20 do
      p = start(:restart, max_restarts: 1_000)
      Pipeline.clock(p)
      # At seven the unit restarts by itself; if that happens first, there is no process to kill.
      with pid when is_pid(pid) <- pid(p, "Unit.First"), do: Process.exit(pid, :kill)
      # A kill after the stop has begun is an error, but the pipeline still ends.
      assert {how, _} = Pipeline.stop(p, catch_up: 50)
      assert how in [:ok, :error]
    end
  end

  test "the policy applies to connections inside the composite" do
    {graph, _} =
      Situ.Graph.build(fn p ->
        Situ.composite(
          Situ.from_enumerable(p, [{1, 1}]),
          "Lossy",
          fn s ->
            s |> Situ.map(& &1, async: true) |> Situ.map(& &1, policy: Delivery.throttle(3))
            Situ.composite(s, "Inner", &Situ.map(&1, fn v -> v end))
          end,
          policy: Delivery.latest()
        )
        |> Situ.map(& &1, async: true)
      end)

    kinds = for {_, edge} <- Enum.sort(graph.edges), do: edge.policy.kind
    assert kinds == [:latest, :throttle, :latest, :unlimited]
  end
end
