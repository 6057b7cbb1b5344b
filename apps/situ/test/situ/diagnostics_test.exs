defmodule Situ.DiagnosticsTest do
  use ExUnit.Case, async: true

  import Situ.Test.Eventually

  alias Situ.Diagnostics.Snapshot
  alias Situ.Fixture.Count
  alias Situ.Pipeline

  test "the Diagnostics stream emits plain snapshots at the clock's pace and a last one at the end" do
    me = self()
    clock = Situ.Clock.manual(0)

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.composite("Box", fn p ->
            Situ.source(p, Count, count: :infinity, interval: 10_000_000)
          end)
          |> Situ.map(& &1, name: "Same")
          |> Situ.each(& &1, policy: Situ.Delivery.latest())

          p |> Situ.Diagnostics.stream() |> Situ.each(&send(me, {:snapshot, &1}))
        end,
        pipeline: [clock: clock, diagnostics: true]
      )

    assert eventually(fn -> Pipeline.state(p) == :running end)

    for _ <- 1..3 do
      Situ.Clock.advance(clock, 100_000_000)
      assert_receive {:snapshot, %Snapshot{state: :running} = snapshot}
      assert plain?(snapshot)
      assert snapshot == snapshot |> :erlang.term_to_binary() |> :erlang.binary_to_term([:safe])
    end

    Situ.Clock.advance(clock, 1)
    {:ok, report} = Pipeline.stop(p)
    assert_receive {:snapshot, %Snapshot{state: :stopping}}
    assert report.snapshot.scopes == ["Box"]
    nodes = Map.new(report.snapshot.nodes, &{&1.path, &1})
    assert nodes["Box.Count"].scope == "Box"
    assert nodes["Box.Count"].kind == :source

    assert nodes["Diagnostics"].outputs == [
             %{name: "out", type: "Situ.Diagnostics.Snapshot", stream: "Diagnostics"}
           ]
  end

  test "reports the counts, drops and latency of every edge, and the sums agree" do
    {:ok, report} =
      Pipeline.run(fn p ->
        stream = Situ.source(p, Count, count: 5_000)
        Situ.each(stream, & &1, name: "All")
        Situ.each(stream, & &1, name: "Few", policy: Situ.Delivery.max_queue(2))
      end)

    edges = report.snapshot.edges
    assert [%{processed: 5_000, dropped: 0, policy: "unlimited"}, few] = edges
    assert few.processed + few.dropped == 5_000
    assert few.policy == "max_queue(2)"

    for edge <- edges,
        do: assert(edge.queue == 0 and edge.emitted == 5_000 and edge.latency_p99 > 0)
  end

  test "prints a running pipeline as a table" do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p |> Situ.source(Count, count: :infinity, interval: 1_000_000) |> Situ.each(& &1)
        end,
        []
      )

    text = ExUnit.CaptureIO.capture_io(fn -> Situ.inspect(p) end)
    for word <- ["Count -> Each", "unlimited", "p99", "memory"], do: assert(text =~ word)
    {:ok, _} = Pipeline.stop(p)
  end

  defmodule Late do
    # At each time in `at`, emits a message that is 5 ms old; messages at odd times were created 1 ms after they
    # happened.
    use Situ.Component, outputs: [out: :any], options: [at: [type: :list]]

    @impl true
    def init(opts), do: {:ok, opts[:at]}

    @impl true
    def handle_start(_context, at), do: {for(time <- at, do: {:timer, time, time}), at}

    @impl true
    def handle_info({:timer, at}, _context, state) do
      time = at - 5_000_000
      data = :binary.copy(<<1>>, 100)

      if rem(at, 2) == 0,
        do: {[{:out, time, data}], state},
        else: {[{:out, message(data, time, at)}], state}
    end

    defp message(data, time, id) do
      %Situ.Message{
        data: data,
        originating_time: time,
        creation_time: time + 1_000_000,
        sequence_id: id
      }
    end
  end

  test "reports ages, handling times and sizes of an edge's messages, in total and for the last second" do
    clock = Situ.Clock.manual(1_000_000_000)
    old = [1_000_000_001, 1_000_000_003]
    new = [11_500_000_000, 11_500_000_004]

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Late, at: old ++ new)
          # Each message takes 3 ms.
          |> Situ.each(fn _ -> Situ.Clock.advance(clock, 3_000_000) end)
        end,
        pipeline: [clock: clock, message_sizes: true]
      )

    assert Pipeline.clock(p) == clock
    Situ.Clock.set(clock, 1_000_000_003)
    processed(p, 2)
    Situ.Clock.set(clock, 10_000_000_000)
    assert [%{window: %{processed: 2}}] = Pipeline.info(p).edges
    Situ.Clock.set(clock, 11_500_000_004)
    processed(p, 4)
    {:ok, report} = Pipeline.stop(p)
    assert [edge] = report.snapshot.edges

    assert %{emitted: 4, processed: 4, dropped: 0, queue: 0} = edge

    # The first two kept their creation times, as an importer's messages do; the later posting time is reported
    # separately.
    assert edge.created_last == 5_000_000 and edge.created_mean == 3_000_000
    assert edge.posted_last == 5_000_000 and edge.posted_mean == 5_000_000
    assert edge.latency_last in [5_000_000, 8_000_000]
    assert edge.handling_last == 3_000_000 and edge.handling_mean == 3_000_000
    assert edge.size_last == 100 and edge.size_mean == 100

    assert %{emitted: 2, processed: 2, handling: 3_000_000, size: 100, span: span} = edge.window
    assert span in 1_500_000_000..1_520_000_000
    assert edge.window.created == 5_000_000
  end

  # Polls until `n` messages have been processed, without advancing the clock.
  defp processed(p, n) do
    case Pipeline.info(p).edges do
      [%{processed: ^n}] -> :ok
      _ -> processed(p, n)
    end
  end

  test "sizes are not measured by default" do
    {:ok, report} =
      Pipeline.run(fn p ->
        p |> Situ.source(Count, count: 3) |> Situ.each(& &1)
      end)

    assert [%{size_last: 0, size_mean: 0, window: %{size: nil}}] = report.snapshot.edges
  end

  test "summarizes all connections or a selection" do
    {:ok, report} =
      Pipeline.run(fn p ->
        stream = Situ.source(p, Count, count: 1_000)
        Situ.each(stream, & &1, name: "All")
        Situ.each(stream, & &1, name: "Few", policy: Situ.Delivery.max_queue(2))
      end)

    all = Situ.Diagnostics.summary(report.snapshot)
    assert %{nodes: 3, sources: 1, edges: 2, inputs: 2, outputs: 3, emitted: 2_000} = all
    assert all.processed + all.dropped == 2_000
    assert_in_delta all.processed_percent + all.dropped_percent, 100.0, 1.0e-6
    assert all.window_emitted == 2_000
    lossless = Situ.Diagnostics.summary(report.snapshot, &(&1.policy == "unlimited"))
    assert %{edges: 1, emitted: 1_000, processed_percent: 100.0} = lossless
  end

  # True if the value contains no pid, reference or function.
  defp plain?(%_{} = struct), do: struct |> Map.from_struct() |> plain?()
  defp plain?(map) when is_map(map), do: Enum.all?(map, fn {k, v} -> plain?(k) and plain?(v) end)
  defp plain?(list) when is_list(list), do: Enum.all?(list, &plain?/1)
  defp plain?(other), do: is_number(other) or is_binary(other) or is_atom(other)
end
