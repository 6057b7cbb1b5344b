defmodule Situ.Python.BatchesTest do
  use ExUnit.Case, async: true
  import Situ.PythonPrograms

  @moduletag :tmp_dir
  @moduletag capture_log: true

  @body """
  def setup(self):
      self.largest = 0

  def on_batch(self, values, messages):
      self.largest = max(self.largest, len(values))
      if 13 in values:
          raise ValueError("13")
      return [{"out": [value, message.time]} for value, message in zip(values, messages)]

  def on_close(self, time):
      return {"out": [self.largest, 0]}
  """

  defp run_part(source, values, opts) do
    Situ.to_list(fn p ->
      p |> Situ.from_enumerable(values, every: 10) |> Situ.Python.component(source, opts)
    end)
  end

  test "contain several messages, and keep their order", %{tmp_dir: dir} do
    results = run_part(write_part(dir, @body), 100..1_099, batch: 50)
    assert Enum.map(Enum.drop(results, -1), &hd/1) == Enum.to_list(100..1_099)
    times = Enum.map(Enum.drop(results, -1), &List.last/1)
    assert times == Enum.sort(times)
    assert [largest, 0] = List.last(results)
    assert largest in 2..50
  end

  test "that fail lose only the message at which they fail", %{tmp_dir: dir} do
    results = run_part(write_part(dir, @body), 1..40, batch: 40, on_error: :skip)
    assert results |> Enum.drop(-1) |> Enum.map(&hd/1) == Enum.to_list(1..40) -- [13]
  end

  test "need on_batch, which returns a result for each value", %{tmp_dir: dir} do
    fail = fn body ->
      {:error, failure} =
        Situ.Pipeline.run(fn p ->
          p
          |> Situ.from_enumerable([1, 2], every: 10)
          |> Situ.Python.component(write_part(dir, body), batch: 8)
        end)

      if is_struct(failure, Situ.Error), do: failure, else: failure.error
    end

    assert fail.("def on_value(self, value, message):\n    pass").what =~ "define on_batch"
    error = fail.("def on_batch(self, values, messages):\n    return []")
    assert error.what =~ "on_batch must return a list with a result for each of the 1 values"
  end
end
