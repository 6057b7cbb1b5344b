defmodule Situ.Pipeline.StressTest do
  # Not async, because it counts the processes, tables and atoms of the whole VM.
  use ExUnit.Case, async: false

  alias Situ.Fixture.Count
  alias Situ.Pipeline

  @moduletag :capture_log
  @moduletag timeout: 120_000

  # The number of schedules and pipelines; `SITU_TIMES` searches longer.
  @schedules 100 * Situ.Test.Budget.repeat_factor()
  @pipelines 400 * Situ.Test.Budget.repeat_factor()

  test "random schedules of start, stop and kill end in time and leave no process" do
    :rand.seed(:exsss, {ExUnit.configuration()[:seed], 2, 3})
    before = Process.list() |> MapSet.new()

    for n <- 1..@schedules do
      {us, result} = :timer.tc(fn -> schedule(:rand.uniform(8)) end)
      assert us < 60_000_000, "schedule #{n} took #{us} us"
      assert match?({:ok, _}, result) or match?({:error, %Situ.Error{}}, result), inspect(result)
    end

    assert leftover(before, 200) == []
  end

  test "many short pipelines leak no processes, tables or atoms" do
    run = fn -> {:ok, _} = Pipeline.run(&build(&1, 5), []) end
    for _ <- 1..200, do: run.()
    before = {MapSet.new(Process.list()), length(:ets.all()), :erlang.system_info(:atom_count)}
    for _ <- 1..@pipelines, do: run.()
    {processes, tables, atoms} = before
    assert leftover(processes, 200) == []
    assert length(:ets.all()) <= tables + 2
    assert :erlang.system_info(:atom_count) - atoms < 50
  end

  defp schedule(kind) do
    count = Enum.random([0, 1, 10, 1_000, :infinity])
    {:ok, p} = Pipeline.start(&build(&1, count), pipeline: [stop_timeout: 2_000])

    case kind do
      1 -> Pipeline.stop(p)
      2 -> together(fn -> Pipeline.stop(p) end)
      3 -> kill(p, 0)
      4 -> kill(p, :rand.uniform(3))
      5 -> Task.async(fn -> kill(p, 0) end) && Pipeline.stop(p)
      6 -> maybe_wait(p, count)
      7 -> Pipeline.stop_part(p, "Side")
      8 -> Task.async(fn -> Pipeline.stop_part(p, "Side") end) && kill(p, :rand.uniform(3))
    end

    Pipeline.stop(p)
    answer(Pipeline.await(p, 30_000))
  end

  # Every stage must have ended once the pipeline has ended, whatever else happened.
  defp answer({:error, %{code: :timeout}} = hang), do: flunk("a hang: #{inspect(hang)}")
  defp answer(result), do: result

  defp maybe_wait(p, :infinity), do: Pipeline.stop(p)
  defp maybe_wait(p, _count), do: Pipeline.await(p, 30_000)

  defp together(fun), do: 1..3 |> Enum.map(fn _ -> Task.async(fun) end) |> Task.await_many(30_000)

  # Kills one of the processes linked to the pipeline (a component) or the pipeline itself.
  defp kill(p, turns) do
    for _ <- 1..turns//1, do: :erlang.yield()

    case Process.info(p, :links) do
      {:links, [_ | _] = links} ->
        links |> Enum.filter(&is_pid/1) |> Enum.random() |> Process.exit(:kill)

      _ ->
        Process.exit(p, :kill)
    end
  end

  defp build(p, count) do
    stream =
      Situ.source(p, Count,
        count: count,
        interval: 20_000,
        on_error: Enum.random([:stop, :restart, :skip])
      )

    left = Situ.map(stream, &(&1 + 1), async: true, on_error: Enum.random([:stop, :restart]))

    right =
      Situ.filter(stream, &(rem(&1, 2) == 0),
        policy: Enum.random([nil, Situ.Delivery.latest(), Situ.Delivery.throttle(2)])
      )

    Situ.composite(left, "Side", fn left ->
      left |> Situ.each(& &1, async: true) |> Situ.map(& &1, async: true)
    end)

    right |> Situ.scan(0, &+/2) |> Situ.each(& &1, policy: Situ.Delivery.max_queue(3))
  end

  defp leftover(before, 0),
    do: Process.list() |> Enum.reject(&(&1 in before)) |> Enum.filter(&stage?/1)

  defp leftover(before, tries) do
    case leftover(before, 0) do
      [] ->
        []

      [pid | _] ->
        # The process may just be ending.
        ref = Process.monitor(pid)

        receive do
          {:DOWN, ^ref, _, _, _} -> :ok
        after
          100 -> Process.demonitor(ref, [:flush])
        end

        leftover(before, tries - 1)
    end
  end

  defp stage?(pid) do
    case Process.info(pid, :dictionary) do
      {:dictionary, dictionary} ->
        match?({Situ.Stage, _, _}, dictionary[:"$initial_call"]) or
          match?({Situ.Pipeline.Launcher, _, _}, dictionary[:"$initial_call"])

      nil ->
        false
    end
  end
end
