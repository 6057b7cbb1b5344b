defmodule Situ.Python.StateTest do
  use ExUnit.Case, async: true
  import Situ.PythonPrograms
  alias Situ.Pipeline

  @moduletag :tmp_dir
  @moduletag capture_log: true

  @body """
  def setup(self):
      self.sum = 0

  def on_value(self, value, message):
      if value == 0:
          os.kill(os.getpid(), 9)
      self.sum += value
      return {"out": self.sum}

  def snapshot(self):
      return {"sum": self.sum}

  def restore(self, data):
      self.sum = data["sum"]
  """

  defp build(source, n, opts) do
    test = self()

    fn p ->
      p
      |> Situ.from_enumerable(1..n, every: 1_000)
      |> Situ.Python.component(source, [out: [out: :integer]] ++ opts)
      |> Situ.each(&send(test, {:sum, &1, &2.originating_time}))
    end
  end

  defp start(source, n, resume, opts) do
    replay = [interval: {0, Situ.Time.s(3_600)}, speed: :max]
    {:ok, p} = Pipeline.start(build(source, n, opts), pipeline: [replay: replay, resume: resume])
    p
  end

  defp await_sums(n), do: for(_ <- 1..n, do: assert_receive({:sum, _, _}))

  defp received_sums do
    receive do
      {:sum, _, _} = message -> [message | received_sums()]
    after
      0 -> []
    end
  end

  # Returns all results of a pipeline that was stopped after a checkpoint, and of one that continues from there.
  defp run_interrupted(source, n, opts) do
    p = start(source, n, %{}, opts)
    first = await_sums(100)

    case Pipeline.checkpoint(p, &{&1, received_sums()}, timeout: 60_000) do
      {:ok, {memories, more}} ->
        {:ok, _} = Pipeline.stop(p)
        received_sums()
        memories = memories |> :erlang.term_to_binary() |> :erlang.binary_to_term()
        {:ok, _} = Pipeline.await(start(source, n, memories, opts), 60_000)
        first ++ more ++ received_sums()

      # On a busy machine, the pipeline may have ended before.
      {:error, %{code: :not_running}} ->
        first ++ received_sums()
    end
  end

  test "a pipeline continues from its checkpoint with the same results", %{tmp_dir: dir} do
    results = run_interrupted(write_part(dir, @body), 20_000, [])
    assert Enum.map(results, &elem(&1, 1)) == Enum.scan(1..20_000, &(&1 + &2))
    assert results == Enum.sort_by(results, &elem(&1, 2))
  end

  test "a checkpoint contains the states of several workers", %{tmp_dir: dir} do
    results = run_interrupted(write_part(dir, @body), 10_000, max: 2)
    alone = fn first -> Enum.scan(first..10_000//2, &(&1 + &2)) end
    expected = Enum.zip_with(alone.(1), alone.(2), &[&1, &2]) |> Enum.concat()
    assert Enum.map(results, &elem(&1, 1)) == expected
  end

  test "after the worker was killed, a checkpoint contains the state of the next one", %{
    tmp_dir: dir
  } do
    source = write_part(dir, @body)
    test = self()

    {:ok, p} =
      Pipeline.start(fn p ->
        p
        |> Situ.timer(every: Situ.Time.ms(20))
        |> Situ.scan(-1, fn _, n -> n + 1 end)
        |> Situ.Python.component(source, on_error: :skip)
        |> Situ.each(&send(test, {:sum, &1, 0}))
      end)

    await_sums(5)
    {:ok, memories} = Pipeline.checkpoint(p, & &1, timeout: 30_000)
    assert %{core: {:own, %{python: <<_, _::binary>>}}} = memories["Part"]
    {:ok, _} = Pipeline.stop(p)
  end

  test "a part that is stopped and started again keeps its state", %{tmp_dir: dir} do
    source = write_part(dir, @body)
    test = self()

    {:ok, p} =
      Pipeline.start(fn p ->
        ticks = p |> Situ.timer(every: Situ.Time.ms(1)) |> Situ.map(fn _ -> 1 end)

        Situ.composite(ticks, "Side", fn ticks ->
          sums = Situ.Python.component(ticks, source, name: "Sum", out: [out: :integer])
          Situ.each(sums, &send(test, {:sum, &1, 0}))
        end)

        Situ.each(ticks, & &1)
      end)

    await_sums(5)
    :ok = Pipeline.stop_part(p, "Side", checkpoint: true)
    {:sum, last, 0} = List.last([{:sum, 5, 0} | received_sums()])
    :ok = Pipeline.start_part(p, "Side", from: :checkpoint)
    next = last + 1
    assert_receive {:sum, ^next, 0}
    assert_receive {:sum, _, 0}
    {:ok, _} = Pipeline.stop(p)
  end

  test "a component without snapshot is named in the error", %{tmp_dir: dir} do
    source = write_part(dir, "def on_value(self, value, message):\n    return {'out': value}")

    {:ok, p} =
      Pipeline.start(fn p ->
        p |> Situ.timer(every: Situ.Time.ms(10)) |> Situ.Python.component(source)
      end)

    assert {:error, error} = Pipeline.checkpoint(p, & &1, timeout: 30_000)
    assert error.code == :no_snapshot
    assert error.what =~ "Part has no method snapshot"
    {:ok, _} = Pipeline.stop(p)
  end
end
