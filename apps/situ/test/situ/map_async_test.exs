defmodule Situ.MapAsyncTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Pipeline

  @moduletag :capture_log
  @replay [replay: [interval: {0, :unbounded}, speed: :max]]

  defp list(values, fun, opts) do
    Situ.to_list(
      &(&1 |> Situ.from_enumerable(values, every: 10) |> Situ.map_async(fun, opts)),
      times: true,
      pipeline: @replay
    )
  end

  defp run(values, fun, opts) do
    me = self()

    result =
      Pipeline.run(
        fn p ->
          p
          |> Situ.from_enumerable(values, every: 10)
          |> Situ.map_async(fun, opts)
          |> Situ.each(&send(me, {:got, &1}))
        end,
        pipeline: @replay
      )

    {result, got()}
  end

  defp got do
    receive do
      {:got, v} -> [v | got()]
    after
      0 -> []
    end
  end

  property "behaves like map, in whatever order the jobs finish", numtests: 30 do
    forall {waits, max} <- {list(integer(0, 3)), integer(1, 4)} do
      work = fn wait ->
        for _ <- 1..(wait * 2_000)//1, do: :erlang.yield()
        wait * 2
      end

      expected = for {w, i} <- Enum.with_index(waits), do: {i * 10, w * 2}
      assert list(waits, work, max: max) == expected
    end
  end

  test "runs at most `max` jobs at the same time" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(1..100, every: 10)
          |> Situ.map_async(
            fn v ->
              send(me, {:begun, v, self()})
              receive do: (:go_on -> v)
            end,
            max: 3
          )
          |> Situ.each(&send(me, {:got, &1}))
        end,
        pipeline: @replay
      )

    jobs = for v <- 1..3, do: begun(v)
    refute_receive {:begun, _, _}, 60
    # The oldest job is still running, so later results wait and count toward the limit.
    send(Enum.at(jobs, 1), :go_on)
    refute_receive {:begun, _, _}, 60
    refute_received {:got, _}
    send(hd(jobs), :go_on)
    for v <- 4..5, do: begun(v)
    assert_receive {:got, 1}, 10_000
    assert_receive {:got, 2}, 10_000
    refute_received {:begun, _, _}
    job = Process.monitor(Enum.at(jobs, 2))
    Process.exit(p, :kill)
    assert_receive {:DOWN, ^job, _, _, _}, 10_000
  end

  defp begun(v) do
    assert_receive {:begun, ^v, pid}, 10_000
    pid
  end

  defp fails_at(n) do
    fn
      ^n -> raise "bang"
      v -> v
    end
  end

  test "an error stops the pipeline at its message, after emitting older results" do
    {result, got} = run(1..200, fails_at(150), max: 8)
    assert {:error, error} = result
    assert error.what =~ "bang"
    assert error.meta.originating_time == 1_490
    assert got == Enum.to_list(1..149)
  end

  test "an error at the last message stops the pipeline" do
    {result, got} = run(1..200, fails_at(200), max: 8)
    assert {:error, %{code: :component_failed}} = result
    assert got == Enum.to_list(1..199)
  end

  test "on_error: :skip loses only the failed message, wherever it is" do
    for n <- [1, 100, 199, 200] do
      {result, got} = run(1..200, fails_at(n), max: 8, on_error: :skip)
      assert {:ok, _report} = result
      assert got == Enum.to_list(1..200) -- [n]
    end
  end

  test "on_error: :restart loses only the failed message, and counts the restarts" do
    work = fn v ->
      for _ <- 1..(rem(v * 7, 5) * 1_000)//1, do: :erlang.yield()
      if rem(v, 50) == 0, do: raise("bang"), else: v
    end

    {{:ok, report}, got} = run(1..200, work, max: 8, on_error: :restart, name: "Work")
    assert got == Enum.reject(1..200, &(rem(&1, 50) == 0))
    assert report.skipped == %{"Work" => 4}

    assert {{:error, %{code: :restarted_too_often}}, _} =
             run(1..100_000, fn _ -> raise("bang") end, max: 8, on_error: :restart)
  end

  test "jobs of a killed process run again, and no result is lost or repeated" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(1..20, every: 10)
          |> Situ.map_async(
            fn v ->
              send(me, {:begun, v, self()})
              receive do: (:go_on -> v)
            end,
            max: 3,
            on_error: :restart,
            name: "Work"
          )
          |> Situ.each(&send(me, {:got, &1}))
        end,
        pipeline: @replay
      )

    kill = fn ->
      [pid] = for %{nodes: ["Work"], pid: "#PID" <> pid} <- Pipeline.info(p).processes, do: pid
      pid |> String.to_charlist() |> :erlang.list_to_pid() |> Process.exit(:kill)
    end

    for v <- 1..3, do: begun(v)
    kill.()
    [first, second, _third] = for v <- 1..3, do: begun(v)
    send(second, :go_on)
    send(first, :go_on)
    assert_receive {:got, 1}, 10_000
    assert_receive {:got, 2}, 10_000
    for v <- 4..5, do: begun(v)
    kill.()
    for v <- 3..5, do: send(begun(v), :go_on)
    for v <- 6..20, do: send(begun(v), :go_on)
    assert {:ok, _report} = Pipeline.await(p)
    assert got() == Enum.to_list(3..20)
  end

  test "a job that exits, throws or is killed is an error" do
    for bad <- [
          fn -> exit(:gone) end,
          fn -> throw(:ball) end,
          fn -> Process.exit(self(), :kill) end
        ] do
      {result, _} = run([1], fn _ -> bad.() end, max: 2)
      assert {:error, %{code: :component_failed}} = result
    end
  end

  test "a job that takes too long is an error" do
    {result, got} =
      run(1..5, fn v -> if v == 3, do: Process.sleep(:infinity), else: v end,
        max: 2,
        timeout: 2_000,
        on_error: :skip
      )

    assert {:ok, _} = result
    assert got == [1, 2, 4, 5]
    {result, _} = run([1], fn _ -> Process.sleep(:infinity) end, timeout: 20)
    assert {:error, %{code: :timeout}} = result
  end
end
