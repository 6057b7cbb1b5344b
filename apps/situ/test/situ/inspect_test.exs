defmodule Situ.PipelineInspectTest do
  use ExUnit.Case, async: true
  alias Situ.{Clock, Pipeline}

  test "streams, nodes, pipelines and snapshots are short" do
    {:ok, report} =
      Pipeline.run(
        fn p ->
          stream = Situ.from_enumerable(p, 1..3, every: 1, name: "Count")
          Situ.each(stream, & &1)
          node = Pipeline.add(p, Situ.Fixture.Pass, name: "Door")
          Pipeline.connect(stream, node, :in)
          {inspect(p), inspect(stream), inspect(node), inspect(Situ.Node.output(node, :out))}
        end,
        pipeline: [name: "Lobby", replay: [speed: :max]]
      )

    {pipeline, stream, node, output} = report.result
    assert pipeline =~ ~r/\A#Situ.Pipeline<#PID<[\d.]+>>\z/
    assert stream == ~s(#Situ.Stream<"Count", :integer>)
    assert node == ~s(#Situ.Node<"Door", Situ.Fixture.Pass, in: in any, out: out any>)
    assert output == ~s(#Situ.Stream<"Door", :any>)
    snapshot = inspect(report.snapshot)

    assert snapshot =~
             ~r/\A#Situ.Diagnostics.Snapshot<"Lobby", completed, \d+ components, \d+ connections, after /
  end

  test "clocks and tests show their time" do
    assert inspect(Clock.manual(5)) == "#Situ.Clock<manual at 5 ns>"
    assert inspect(Clock.real()) == "#Situ.Clock<real>"
    clock = Clock.virtual(0, 2.0)
    :ok = Clock.pause(clock)
    assert inspect(clock) =~ ~r/\A#Situ.Clock<virtual at 1970-01-01T00:00:\S+Z, speed 0.0>\z/
    t = Situ.Test.start([:door], fn %{door: door} -> door end)
    assert inspect(t) == "#Situ.Test<inputs: :door; at 0 ns>"
    {:ok, _} = Situ.Test.stop(t)
  end
end
