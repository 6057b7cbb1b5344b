defmodule Situ.Experiment.JobQueueTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Experiment.JobQueue

  # A step takes a job for a node, finishes the jobs of a node, or loses a node with its jobs. At the end, one node
  # takes all jobs that are left.
  defp run_steps(queue, [], running, done) do
    case JobQueue.take(queue, :last) do
      {{:ok, job}, queue} -> run_steps(queue, [], running, [job | done])
      {:empty, _} -> for({_, job} <- running, do: job) ++ done
    end
  end

  defp run_steps(queue, [{:take, node} | steps], running, done) do
    case JobQueue.take(queue, node) do
      {{:ok, job}, queue} -> run_steps(queue, steps, [{node, job} | running], done)
      {:empty, queue} -> run_steps(queue, steps, running, done)
    end
  end

  defp run_steps(queue, [{:finish, node} | steps], running, done) do
    {finished, running} = Enum.split_with(running, &(elem(&1, 0) == node))
    run_steps(queue, steps, running, for({_, job} <- finished, do: job) ++ done)
  end

  defp run_steps(queue, [{:lose, node} | steps], running, done) do
    {lost, running} = Enum.split_with(running, &(elem(&1, 0) == node))
    queue = JobQueue.forget_node(queue, node)

    queue =
      Enum.reduce(lost, queue, fn {_, {session, _} = job}, queue ->
        JobQueue.put_back(queue, session, job)
      end)

    run_steps(queue, steps, running, done)
  end

  property "every job is done once, whatever nodes are lost" do
    steps = list({one_of([:take, :take, :finish, :lose]), one_of([:a, :b, :c])})

    forall {sessions, steps} <- {list(one_of([:p1, :p2, :p3])), steps} do
      jobs = for {session, n} <- Enum.with_index(sessions), do: {session, {session, n}}
      done = jobs |> JobQueue.new() |> run_steps(steps, [], [])
      assert Enum.sort(done) == Enum.sort(for {_, job} <- jobs, do: job)
    end
  end

  test "another node continues the session of a lost node with its first job" do
    queue = JobQueue.new(p1: 1, p1: 2, p2: 3, p2: 4, p2: 5)
    {{:ok, 1}, queue} = JobQueue.take(queue, :a)
    {{:ok, 3}, queue} = JobQueue.take(queue, :b)
    queue = queue |> JobQueue.forget_node(:a) |> JobQueue.put_back(:p1, 1)
    {{:ok, 4}, queue} = JobQueue.take(queue, :b)
    assert {{:ok, 1}, _} = JobQueue.take(queue, :c)
  end
end
