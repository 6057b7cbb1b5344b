defmodule Situ.ConnectorTest do
  use ExUnit.Case, async: true
  doctest Situ.Connector

  alias Situ.{Connector, Delivery, Pipeline}

  @moduletag :capture_log

  # Starts a target that takes a message only when the test allows it.
  defp slow_target(connector, opts) do
    test = self()

    {:ok, target} =
      Pipeline.start(
        fn p ->
          p
          |> Connector.receive(connector, opts)
          |> Situ.each(
            fn v ->
              send(test, {:at_work, self(), v})
              receive do: (:go_on -> :ok)
            end,
            async: true,
            policy: Delivery.throttle(10)
          )
        end,
        []
      )

    :ok = Connector.await_open(connector, 30_000)
    target
  end

  defp sender(connector, n, opts \\ []) do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p |> Situ.from_enumerable(0..(n - 1)//1, every: 1) |> Connector.send(connector, opts)
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    p
  end

  # Polls until two successive reads return the same counts.
  defp at_rest(p, before \\ nil) do
    edges = Pipeline.info(p).edges
    counts = Enum.map(edges, &{&1.emitted, &1.processed, &1.dropped})

    if counts == before do
      edges
    else
      Process.sleep(20)
      at_rest(p, counts)
    end
  end

  test "a slow target makes the sender wait" do
    connector = Connector.new("c")
    target = slow_target(connector, window: 100)
    source = sender(connector, 100_000)
    assert_receive {:at_work, _, 0}, 10_000
    [%{processed: sent}] = at_rest(source)
    assert sent <= 100 + 10 + 512
    assert Enum.all?(at_rest(target), &(&1.queue <= 120))
    for p <- [source, target], do: Process.exit(p, :kill)
  end

  test "a lossy policy on the sending side keeps the sender running" do
    connector = Connector.new("c")
    target = slow_target(connector, window: 2)
    source = sender(connector, 20_000, policy: Delivery.latest())
    assert_receive {:at_work, _, _}, 10_000
    # The target would receive messages for as long as it lives.
    Process.exit(target, :kill)
    assert {:ok, report} = Pipeline.await(source, 30_000)
    assert [%{dropped: dropped, processed: processed}] = report.snapshot.edges
    assert dropped + processed == 20_000 and dropped > 0
  end

  test "every target receives every message from the first, and the sender ends after all targets have them" do
    connector = Connector.new("c")
    test = self()

    targets =
      for i <- 1..2 do
        {:ok, target} =
          Pipeline.start(
            fn p -> p |> Connector.receive(connector) |> Situ.each(&send(test, {i, &1})) end,
            []
          )

        target
      end

    for _ <- 1..2, do: :ok = Connector.await_open(connector, 30_000)
    opened(connector, 2)
    assert {:ok, _} = connector |> sender(5_000) |> Pipeline.await(30_000)
    for target <- targets, do: assert({:ok, _} = Pipeline.stop(target))
    for i <- 1..2, do: assert(got(i) == Enum.to_list(0..4_999))
  end

  test "a target that dies does not block the sender" do
    connector = Connector.new("c")
    target = slow_target(connector, window: 10)
    source = sender(connector, 50_000)
    assert_receive {:at_work, _, 0}, 10_000
    Process.exit(target, :kill)
    assert {:ok, _} = Pipeline.await(source, 30_000)
  end

  test "without a target the sender continues and its messages are lost" do
    connector = Connector.new("c")
    assert {:ok, _} = connector |> sender(5_000) |> Pipeline.await(30_000)
    assert {:error, %{code: :timeout}} = Connector.await_open(connector, 0)
  end

  defp opened(connector, n) do
    if length(Registry.lookup(Connector.Ends, connector.ref)) < n, do: opened(connector, n)
  end

  defp got(i) do
    receive do
      {^i, v} -> [v | got(i)]
    after
      0 -> []
    end
  end
end
