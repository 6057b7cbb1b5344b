defmodule Situ.Cluster.LogLinesTest do
  # Other tests in this VM may log at the same time, so only the lines of this test are checked.
  use ExUnit.Case, async: false
  alias Situ.Cluster.LogLines
  require Logger

  setup do
    on_exit(fn -> :logger.remove_handler(LogLines) end)
  end

  @tag capture_log: true
  test "keeps the last lines, numbered, and reads from a given line" do
    assert LogLines.read() == []
    LogLines.start_handler()
    Logger.warning("the door\nis open")
    Logger.error(["caf", "é ", <<255>>])
    :logger.info("~p of ~s", [1, "x"])
    lines = LogLines.read()
    assert %{level: :warning} = door = Enum.find(lines, &(&1.text =~ "the door"))
    assert door.text =~ "is open" and not String.contains?(door.text, "\n")
    numbers = for line <- lines, do: line.n
    assert numbers == Enum.sort(Enum.uniq(numbers))
    refute Enum.any?(LogLines.read(door.n), &(&1.n <= door.n))

    # Logger itself drops lines when too many arrive together.
    event = &%{level: :warning, meta: %{time: 1_000 + &1}, msg: {:string, "line #{&1}"}}
    for i <- 1..2_100, do: LogLines.log(event.(i), %{})
    assert length(LogLines.read(0, 5)) == 5
    kept = LogLines.read(0, 10_000)
    assert length(kept) <= 2_000
    assert Enum.any?(kept, &(&1.text == "line 2100"))
    refute Enum.any?(kept, &(&1.text == "line 1"))
  end
end
