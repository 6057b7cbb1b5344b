defmodule Situ.Studio.Visualizers.SpansTest do
  # Intervals of time inside of messages.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking

  setup do: {:ok, session: session()}

  test "intervals are drawn over their span, also when they began before the window or are told of after it",
       %{session: session} do
    put(session, "speech", [
      {1_200_000_000, %{start: 1_100_000_000, stop: 1_200_000_000, text: "before"}},
      {1_500_000_000, %{start: 1_300_000_000, stop: 1_500_000_000, text: "begins before"}},
      {1_900_000_000, %{start: 1_600_000_000, stop: 1_900_000_000, text: "told after"}},
      {1_950_000_000, %{start: 1_940_000_000, stop: 1_950_000_000, text: "after"}}
    ])

    assert %{kind: 2, base: 1_300_000_000, payload: json} =
             shown(session, "speech", "spans", 1_400_000_000, 1_700_000_000)

    assert [
             [0, 200_000_000, "begins before", "span"],
             [300_000_000, 600_000_000, "told after", "span"]
           ] = json(json)
  end
end
