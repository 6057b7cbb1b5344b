defmodule Situ.PipelineTest do
  use ExUnit.Case, async: true
  doctest Situ.Pipeline
  doctest Situ.Node
  doctest Situ.Graph
  doctest Situ.Delivery
  doctest Situ.Clock
  doctest Situ.Diagnostics
  doctest Situ.Diagnostics.Snapshot

  alias Situ.Fixture.Count
  alias Situ.Pipeline

  test "a source, a chain and its effect handle every message once, in order" do
    me = self()

    {:ok, report} =
      Pipeline.run(fn p ->
        p
        |> Situ.source(Count, count: 2_500)
        |> Situ.map(&(&1 * 2))
        |> Situ.filter(&(rem(&1, 3) == 0))
        |> Situ.each(&send(me, {:got, &1}), async: true)
      end)

    assert report.errors == []
    assert report.closed == ["Count", "Map", "Filter", "Each"]
    assert drain() == for(n <- 0..2_499, rem(n * 2, 3) == 0, do: n * 2)
  end

  test "run returns an error that names the component, input and time" do
    {result, log} =
      ExUnit.CaptureLog.with_log(fn ->
        Pipeline.run(fn p ->
          p |> Situ.source(Count, count: 5) |> Situ.map(&(1 / (&1 - 2)), name: "Invert")
        end)
      end)

    assert {:error, %Situ.Error{code: :component_failed, meta: meta}} = result
    assert %{component: "Invert", input: :in, originating_time: time} = meta
    assert is_integer(time)
    assert log =~ "Invert failed"
  end

  defp drain do
    receive do
      {:got, value} -> [value | drain()]
    after
      0 -> []
    end
  end
end
