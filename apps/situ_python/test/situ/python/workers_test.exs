defmodule Situ.Python.WorkersTest do
  use ExUnit.Case, async: true
  import Situ.PythonPrograms

  @moduletag :tmp_dir
  @moduletag capture_log: true

  # Later messages of a round take less time, so without a merger they would overtake the others.
  @body """
  def setup(self):
      self.count = 0

  def on_value(self, value, message):
      self.count += 1
      if value == 13:
          raise ValueError("13")
      if value == 17:
          os.kill(os.getpid(), 9)
      time.sleep(0.002 * (3 - value % 3))
      if value % 5 == 0:
          return None
      return [{"out": [value, os.getpid()]}] if value % 2 else [(message.time + 1, {"out": [value, os.getpid()]})]

  def on_close(self, time):
      return {"out": ["closed", self.count]}
  """

  defp run_workers(source, values, opts) do
    Situ.to_list(fn p ->
      p
      |> Situ.from_enumerable(values, every: 10)
      |> Situ.Python.component(source, [max: 3] ++ opts)
    end)
  end

  defp values(results), do: for([value, _] <- results, is_integer(value), do: value)

  test "emit results in the order of the messages", %{tmp_dir: dir} do
    results = run_workers(write_part(dir, @body), 100..160, out: [out: :list])
    assert values(results) == Enum.reject(100..160, &(rem(&1, 5) == 0))
    processes = for [value, process] <- results, is_integer(value), uniq: true, do: process
    assert length(processes) == 3
    counts = for ["closed", count] <- Enum.take(results, -3), do: count
    assert Enum.sum(counts) == 61
    assert Enum.max(counts) - Enum.min(counts) <= 1
  end

  for how <- [:skip, :restart] do
    test "keep the order after errors with #{inspect(how)}", %{tmp_dir: dir} do
      results = run_workers(write_part(dir, @body), 1..30, on_error: unquote(how))
      assert values(results) == Enum.reject(1..30, &(rem(&1, 5) == 0 or &1 in [13, 17]))
    end
  end

  test "end the pipeline after an error with :stop", %{tmp_dir: dir} do
    {:error, failure} =
      Situ.Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(1..30, every: 10)
        |> Situ.Python.component(write_part(dir, @body), max: 2)
      end)

    error = if is_struct(failure, Situ.Error), do: failure, else: failure.error
    assert error.what =~ "ValueError: 13"
  end

  test "need a single stream", %{tmp_dir: dir} do
    assert_raise Situ.Error, ~r/needs a single stream/, fn ->
      Situ.to_list(fn p ->
        left = Situ.from_enumerable(p, 1..3, every: 10)
        right = Situ.from_enumerable(p, 1..3, every: 10)
        Situ.Python.component([left: left, right: right], write_part(dir, @body), max: 2)
      end)
    end
  end
end
