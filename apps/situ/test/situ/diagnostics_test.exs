defmodule Situ.DiagnosticsTest do
  use ExUnit.Case, async: true

  alias Situ.Diagnostics.Snapshot
  alias Situ.Fixture.Count
  alias Situ.Pipeline

  test "the Diagnostics stream: snapshots at the clock's pace and a last one at the end, of plain data only" do
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

    # Answers when it runs.
    assert Pipeline.clock(p) == clock

    for _ <- 1..3 do
      Situ.Clock.advance(clock, 100_000_000)
      assert_receive {:snapshot, %Snapshot{state: :running} = snapshot}, 2_000
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

  test "counts, drops and latency of every edge; the sums agree" do
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

  test "a running pipeline as a table for people" do
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

  # No pid, reference or function anywhere in it.
  defp plain?(%_{} = struct), do: struct |> Map.from_struct() |> plain?()
  defp plain?(map) when is_map(map), do: Enum.all?(map, fn {k, v} -> plain?(k) and plain?(v) end)
  defp plain?(list) when is_list(list), do: Enum.all?(list, &plain?/1)
  defp plain?(other), do: is_number(other) or is_binary(other) or is_atom(other)
end
