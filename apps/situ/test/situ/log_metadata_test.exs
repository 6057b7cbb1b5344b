defmodule Situ.LogMetadataTest do
  # Not async, because it captures the log.
  use ExUnit.Case, async: false
  import ExUnit.CaptureLog
  require Logger

  @metadata [:pipeline, :component, :originating_time]

  test "lines of a component name it and its pipeline" do
    log =
      capture_log([metadata: @metadata], fn ->
        {:ok, _} =
          Situ.Pipeline.run(
            fn p ->
              p
              |> Situ.from_enumerable([1], every: 1)
              |> Situ.each(fn _ -> Logger.warning("seen") end, name: "Eyes", async: true)
            end,
            pipeline: [name: "Hall"]
          )
      end)

    assert log =~ ~r/pipeline=Hall component=Eyes .*seen/
  end

  test "an error that a component skips names the pipeline, the component and the message" do
    log =
      capture_log([metadata: @metadata], fn ->
        {:ok, _} =
          Situ.Pipeline.run(
            fn p ->
              p
              |> Situ.from_enumerable([{7, 0}])
              |> Situ.map(&div(1, &1), name: "Divide", on_error: :skip)
            end,
            pipeline: [name: "Hall", replay: [interval: {0, :unbounded}]]
          )
      end)

    assert log =~ ~r/pipeline=Hall component=Divide originating_time=7 .*Divide failed/
  end
end
