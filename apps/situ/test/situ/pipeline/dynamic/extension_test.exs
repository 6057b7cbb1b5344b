defmodule Situ.Pipeline.Dynamic.ExtensionTest do
  use ExUnit.Case, async: true

  alias Situ.{Clock, Pipeline, Time}
  alias Situ.Fixture.{Closing, Count, Pass}

  @moduletag :capture_log

  defmodule Refusing do
    use Situ.Component,
      inputs: [in: :any],
      options: [how: [type: :atom, required: true], to: [type: :pid, required: true]]

    @impl true
    def init(opts) do
      if opts[:how] == :init,
        do: {:error, Situ.Error.new(:refused, "no")},
        else: {:ok, Map.new(opts)}
    end

    @impl true
    def handle_start(_context, %{how: :start}), do: raise("no start")
    def handle_start(_context, %{how: :die}), do: Process.exit(self(), :kill)
    def handle_start(_context, state), do: {[], state}
  end

  defmodule Clockwork do
    # Reports its times when it starts, and raises on request.
    use Situ.Component,
      inputs: [in: :any],
      options: [to: [type: :pid, required: true], k: [type: :integer, default: 1]]

    @impl true
    def init(opts), do: {:ok, Map.new(opts)}

    @impl true
    def handle_start(context, state) do
      send(state.to, {:began, state.k, context.start_time, context.now})
      {[], state}
    end

    @impl true
    def handle_message(:in, %{data: :raise}, _context, _state), do: raise("as asked")
    def handle_message(:in, _message, _context, state), do: {[], state}
  end

  defp start(opts \\ []) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1), name: "Count")
          |> Situ.each(&send(me, {:main, &1}), async: true, name: "Main")
        end,
        opts
      )

    p
  end

  defp told(stream, tag, opts \\ []) do
    me = self()
    Situ.each(stream, &send(me, {tag, &1}), opts)
  end

  defp all(tag) do
    receive do
      {^tag, v} -> [v | all(tag)]
    after
      0 -> []
    end
  end

  defp names(p), do: Enum.map(Pipeline.info(p).nodes, & &1.path)

  test "an added component starts when it is added, and receives the current time when it restarts" do
    p = start()
    assert_receive {:main, 20}, 30_000
    me = self()
    input = Situ.Connector.new("input")
    before = Pipeline.now(p)

    {:ok, _} =
      Pipeline.extend(p, fn p ->
        stream = Situ.Connector.receive(p, input)
        Situ.via(stream, Clockwork, to: me, name: "Clockwork", on_error: :restart)
      end)

    assert_receive {:began, 1, start, start}, 30_000
    assert start in before..Pipeline.now(p)

    before = Pipeline.now(p)
    :ok = Pipeline.replace(p, "Clockwork", to: me, k: 2)
    assert_receive {:began, 2, ^start, now}, 30_000
    assert now >= before

    before = Pipeline.now(p)
    Situ.Connector.deliver_messages(input, [message(:raise, before)])
    assert_receive {:began, 2, ^start, now}, 30_000
    assert now >= before
    {:ok, _} = Pipeline.stop(p)
  end

  test "an added source starts now, not at the pipeline's start" do
    p = start()
    assert_receive {:main, 20}, 30_000
    me = self()
    before = Pipeline.now(p)

    {:ok, _} =
      Pipeline.extend(p, fn p ->
        p
        |> Situ.from_enumerable([:a, :b], every: Time.ms(1))
        |> Situ.each(fn data, message -> send(me, {:new, data, message.originating_time}) end)
      end)

    assert_receive {:new, :a, a}, 30_000
    assert_receive {:new, :b, b}, 30_000
    assert a >= before
    assert b == a + Time.ms(1)
    {:ok, _} = Pipeline.stop(p)
  end

  defp message(data, time),
    do: %Situ.Message{data: data, originating_time: time, creation_time: time}

  test "an added consumer receives every message from its first one" do
    p = start()
    assert_receive {:main, 0}
    me = self()

    {:ok, _} =
      Pipeline.extend(p, fn p ->
        count = Pipeline.stream(p, "Count")
        doubled = count |> Situ.map(&(&1 * 2), name: "Double") |> Situ.via(Pass, name: "Pass")
        Situ.each(doubled, &send(me, {:added, &1}), name: "Told")
        # These two paths join again.
        count |> Situ.join(doubled) |> Situ.each(&send(me, {:joined, &1}), name: "Joined")
      end)

    assert_receive {:added, first}
    assert_receive {:added, _}
    assert {:ok, report} = Pipeline.stop(p)
    added = [first | all(:added)]
    # The second message was already received above.
    first = hd(added)
    assert Enum.all?(all(:joined), fn {v, doubled} -> doubled == 2 * v end)
    assert Enum.all?(added, &(rem(&1, 2) == 0))
    assert added -- Enum.to_list(first..List.last(added)//2) == []
    assert report.errors == []
    for name <- ~w(Double Pass Told Joined), do: assert(name in report.closed)
    # Upstream components close first, as always.
    place = report.closed |> Enum.with_index() |> Map.new()
    assert place["Count"] < place["Double"] and place["Double"] < place["Pass"]
  end

  test "under load no message is lost or duplicated, wherever a part is added or removed" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p -> Situ.source(p, Count, count: :infinity, interval: 1, name: "Count") end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    for n <- 1..20 do
      name = "Part#{n}"

      {:ok, _} =
        Pipeline.extend(p, fn p ->
          p
          |> Pipeline.stream("Count")
          |> Situ.composite(name, fn count ->
            count
            |> Situ.map(& &1, async: true)
            |> Situ.each(&send(me, {name, &1}), async: true, policy: Situ.Delivery.throttle(5))
          end)
        end)

      assert_receive {^name, first}
      assert :ok = Pipeline.remove(p, name)
      seen = [first | all(name)]
      assert seen == Enum.to_list(first..List.last(seen)//1)
    end

    assert names(p) == ["Count"]
    assert %{life: %{stages: stages, links: links}} = :sys.get_state(p)
    assert map_size(stages) == 1
    assert links.topology == %{}
    assert {:ok, _} = Pipeline.stop(p, catch_up: 0)
  end

  test "an added source runs to its end and does not end the rest" do
    p = start()

    {:ok, stream} =
      Pipeline.extend(p, fn p ->
        p |> Situ.from_enumerable([{1, :a}, {2, :b}], name: "More") |> told(:more)
      end)

    assert %Situ.Stream{} = stream
    assert_receive {:more, :a}
    assert_receive {:more, :b}
    assert_receive {:main, n}
    for m <- (n + 1)..(n + 20), do: assert_receive({:main, ^m})
    assert Pipeline.state(p) == :running
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "an extension of an ended stream sees its end" do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p |> Situ.from_enumerable([{0, :x}], name: "Short") |> Situ.each(& &1, async: true)
          Situ.from_enumerable(p, [{0, :x}, {40, :x}], name: "Long")
        end,
        pipeline: [clock: Clock.manual(0)]
      )

    me = self()
    closed(p, "Short")

    assert {:ok, _} =
             Pipeline.extend(p, &(&1 |> Pipeline.stream("Short") |> Situ.via(Closing, to: me)))

    assert_receive {:closed, :in, 0}
    assert {:ok, _} = Pipeline.stop(p)
  end

  defp closed(p, name) do
    %{life: %{stages: stages}} = :sys.get_state(p)

    case Enum.find(stages, fn {_, m} -> m.path == "Each" end) do
      {_, %{open?: false}} -> :ok
      _ -> closed(p, name)
    end
  end

  test "an invalid extension returns an error and leaves the graph unchanged" do
    p = start()
    me = self()

    for {code, fun} <- [
          unknown_stream: &Pipeline.stream(&1, "Cuont"),
          duplicate_name:
            &(&1 |> Pipeline.stream("Count") |> Situ.map(fn v -> v end, name: "Main")),
          unconnected_input: &Pipeline.add(&1, Pass, name: "Alone"),
          refused: &(&1 |> Pipeline.stream("Count") |> Situ.via(Refusing, how: :init, to: me)),
          component_failed:
            &(&1 |> Pipeline.stream("Count") |> Situ.via(Refusing, how: :start, to: me)),
          component_killed:
            &(&1 |> Pipeline.stream("Count") |> Situ.via(Refusing, how: :die, to: me))
        ] do
      assert {:error, %{code: ^code}} = Pipeline.extend(p, fun)
    end

    gone(p)
    assert names(p) == ["Count", "Main"]
    assert_receive {:main, _}
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  # Waits until the processes of the refused extension have ended.
  defp gone(p), do: if(map_size(:sys.get_state(p).stages) == 2, do: :ok, else: gone(p))

  test "many processes can extend a pipeline at the same time" do
    p = start()
    me = self()

    tasks =
      for n <- 1..20 do
        Task.async(fn ->
          Pipeline.extend(p, fn p ->
            p |> Pipeline.stream("Count") |> Situ.each(&send(me, {n, &1}), name: "Each#{n}")
          end)
        end)
      end

    assert Enum.all?(Task.await_many(tasks), &match?({:ok, _}, &1))
    for n <- 1..20, do: assert_receive({^n, _})
    removals = for n <- 1..20, do: Task.async(fn -> Pipeline.remove(p, "Each#{n}") end)
    assert Enum.all?(Task.await_many(removals), &(&1 == :ok))
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "names are free again after a removal" do
    p = start()

    for _ <- 1..3 do
      assert {:ok, _} =
               Pipeline.extend(p, fn p ->
                 Situ.composite(Pipeline.stream(p, "Count"), "Side", fn s ->
                   s |> Situ.map(& &1, name: "Map") |> Situ.name("Side stream")
                 end)
               end)

      assert "Side.Map" in names(p)
      assert :ok = Pipeline.remove(p, "Side")
      refute "Side.Map" in names(p)
    end

    assert {:ok, _} = Pipeline.stop(p)
  end

  test "a part removed during an extension stays removed, along with its names" do
    p = start()

    assert {:ok, _} =
             Pipeline.extend(p, fn p ->
               Situ.composite(Pipeline.stream(p, "Count"), "Old", fn s ->
                 s |> Situ.map(& &1, name: "Map") |> Situ.name("Old stream")
               end)
             end)

    assert {:ok, tap} = Situ.attach_tap({p, "Count"}, fn _ -> :ok end)

    assert {:ok, _} =
             Pipeline.extend(p, fn handle ->
               :ok = Situ.detach_tap(tap)
               :ok = Pipeline.remove(p, "Old")
               handle |> Pipeline.stream("Count") |> told(:new, name: "New")
             end)

    assert_receive {:new, _}
    assert Enum.sort(names(p)) == ["Count", "Main", "New"]
    refute "Old" in Pipeline.info(p).scopes

    refute Enum.any?(Pipeline.info(p).nodes, fn n ->
             Enum.any?(n.outputs, &(&1.stream == "Old stream"))
           end)

    # Extending a part that was removed is an error, and nothing of the extension runs.
    assert {:ok, _} =
             Pipeline.extend(p, fn p ->
               Situ.composite(Pipeline.stream(p, "Count"), "Old", fn s -> told(s, :old) end)
             end)

    inside = %Situ.Graph.Handle{pid: p, ref: make_ref(), scope: "Old"}

    assert {:error, %{code: :not_running}} =
             Pipeline.extend(inside, fn handle ->
               :ok = Pipeline.remove(p, "Old")
               told(Pipeline.stream(handle, "Count"), :late, name: "Late")
             end)

    assert Enum.sort(names(p)) == ["Count", "Main", "New"]

    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "an extension returns an error if the pipeline is stopped in the meantime" do
    p = start()
    me = self()

    task =
      Task.async(fn ->
        Pipeline.extend(p, fn p -> Situ.source(p, Situ.Fixture.Held, to: me) end)
      end)

    assert_receive {:held, held}
    stop = Task.async(fn -> Pipeline.stop(p) end)
    assert {:error, %{code: :not_running}} = Task.await(task)
    send(held, :go)
    assert {:ok, _} = Task.await(stop)
    assert {:error, %{code: :not_running}} = Pipeline.extend(p, & &1)
  end
end
