defmodule Situ.Application.PipelineResultsTest do
  # Not async: large results discard the results of pipelines in other tests.
  use ExUnit.Case, async: false

  alias Situ.Application.PipelineResults

  defp put_result(words) do
    pid = spawn(fn -> :ok end)
    PipelineResults.put_result(pid, {:ok, Tuple.duplicate(0, words)})
    pid
  end

  defp kept?(pid), do: match?({:ok, {:ok, _}}, PipelineResults.fetch_result(pid))

  test "large results are discarded, the oldest first" do
    pids = for _ <- 1..5, do: put_result(3_000_000)
    assert Enum.map(pids, &kept?/1) == [false, false, false, true, true]
    small = for _ <- 1..10, do: put_result(10)
    assert Enum.all?(small, &kept?/1)
  end

  test "a result above the limit replaces all others" do
    small = put_result(10)
    large = put_result(9_000_000)
    assert kept?(large)
    refute kept?(small)
    # Frees the memory for other tests.
    next = put_result(10)
    assert kept?(next)
    refute kept?(large)
  end

  test "no more than 256 results are kept" do
    pids = for _ <- 1..300, do: put_result(2)
    assert Enum.count(pids, &kept?/1) == 256
    assert kept?(List.last(pids))
  end
end
