defmodule Situ.Parallel.CheckpointTest do
  # Tests checkpoints of a pipeline whose parallel operator has branches.
  use ExUnit.Case, async: true

  alias Situ.Pipeline

  @moduletag :capture_log
  # So many that the pipeline cannot end before it is saved.
  @count 10_000

  # Keys come and go, and windows leave outputs undecided at any moment.
  defp maps do
    for n <- 1..@count, do: for(key <- 0..4, rem(n, key + 5) != 0, into: %{}, do: {key, n * key})
  end

  defp build(branch, opts) do
    me = self()

    fn p ->
      p
      |> Situ.from_enumerable(maps(), every: 1_000)
      |> Situ.parallel(fn _key, part -> branch.(part) end, opts)
      |> Situ.each(&send(me, {:out, &2.originating_time, &1}))
    end
  end

  defp start(build, resume) do
    pipeline = [replay: [interval: {0, :unbounded}, speed: :max], resume: resume]
    {:ok, pid} = Pipeline.start(build, pipeline: pipeline)
    pid
  end

  defp outputs(list) do
    receive do
      {:out, time, data} -> outputs([{time, data} | list])
    after
      0 -> Enum.reverse(list)
    end
  end

  defp run_to_end(build, resume) do
    {:ok, _} = build |> start(resume) |> Pipeline.await()
    outputs([])
  end

  # Saves the pipeline after its first output, ends it, and continues from the saved states.
  defp run_interrupted(build) do
    pid = start(build, %{})
    assert_receive {:out, _, _} = first
    {:ok, {saved, before}} = Pipeline.checkpoint(pid, &{&1, outputs([])})
    monitor = Process.monitor(pid)
    Process.exit(pid, :kill)
    assert_receive {:DOWN, ^monitor, :process, ^pid, _}
    outputs([])
    saved = saved |> :erlang.term_to_binary() |> :erlang.binary_to_term()
    [Tuple.delete_at(first, 0) | before] ++ run_to_end(build, saved)
  end

  test "a pipeline with branches continues from a checkpoint" do
    window = &Situ.window(&1, -1..1, fn list -> Enum.sum(list) end)

    for {branch, opts} <- [
          {&Situ.sum/1, []},
          {&Situ.sum/1, [until: {:absent, 2}, or_default: 0]},
          {window, [only_present: true, until: {:absent, 1}, or_default: 0]},
          {&Situ.join(&1, Situ.delta(&1)), []}
        ] do
      build = build(branch, opts)
      assert run_interrupted(build) == run_to_end(build, %{})
    end
  end

  test "branches in processes cannot be saved" do
    pid = start(build(& &1, branches: :processes), %{})
    assert_receive {:out, _, _}
    assert {:error, %{code: :no_snapshot} = error} = Pipeline.checkpoint(pid, & &1)
    assert error.what == "cannot take a snapshot of Parallel: its state holds a reference"
    Pipeline.stop(pid)
  end
end
