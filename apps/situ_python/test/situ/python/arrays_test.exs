defmodule Situ.Python.ArraysTest do
  use ExUnit.Case, async: true
  import Situ.PythonPrograms
  alias Situ.Tensor

  @moduletag :tmp_dir
  @moduletag :numpy
  @moduletag capture_log: true

  @size 300_000
  # Less than the values below need together, so some are copied.
  @memory 2_000_000

  defp run_part(source, values) do
    Situ.to_list(fn p ->
      p
      |> Situ.from_enumerable(values, every: 10)
      |> Situ.Python.component(source,
        python: numpy_python(),
        out: [out: Tensor],
        shared_memory: @memory
      )
    end)
  end

  defp assert_filled(tensors, values) do
    assert length(tensors) == length(values)

    for {tensor, value} <- Enum.zip(tensors, values),
        do: assert(tensor.data == :binary.copy(<<value>>, @size))
  end

  test "that Python creates in shared memory keep their values", %{tmp_dir: dir} do
    source =
      write_part(dir, """
      def setup(self):
          self.before = None

      def on_value(self, value, message):
          array = self.empty(#{@size})
          array[:] = value
          # An array that was returned before must not change, and must not be reused while it is in use.
          if self.before is not None:
              assert (self.before == value - 1).all()
          self.before = array
          return {"out": array}
      """)

    values = Enum.to_list(1..60)
    # All results are held until the end.
    assert_filled(run_part(source, values), values)
  end

  test "can be returned several times, and by parts", %{tmp_dir: dir} do
    source =
      write_part(dir, """
      def setup(self):
          self.array = self.empty(2 * #{@size})
          self.array[:#{@size}] = 1
          self.array[#{@size}:] = 2

      def on_value(self, value, message):
          part = self.array[:#{@size}] if value == 1 else self.array[#{@size}:]
          return {"out": part}
      """)

    values = for n <- 0..29, do: rem(n, 2) + 1
    assert_filled(run_part(source, values), values)
  end

  test "survive the end of their worker", %{tmp_dir: dir} do
    source =
      write_part(dir, """
      def on_value(self, value, message):
          array = self.empty(#{@size})
          array[:] = value
          return {"out": array}
      """)

    tensors = for value <- [5, 6], do: run_part(source, [value]) |> hd()
    :erlang.garbage_collect()
    assert_filled(tensors, [5, 6])
  end

  test "of a worker that truncates the shared memory do not affect the VM", %{tmp_dir: dir} do
    source =
      write_part(dir, """
      def on_value(self, value, message):
          array = self.empty(#{@size})
          array[:] = 7
          if value == 3:
              os.ftruncate(self._memory._file, 0)
          return {"out": array}
      """)

    test = self()

    {:error, failure} =
      Situ.Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(1..5, every: 10)
        |> Situ.Python.component(source, python: numpy_python(), out: [out: Tensor])
        |> Situ.each(&send(test, &1))
      end)

    error = if is_struct(failure, Situ.Error), do: failure, else: failure.error
    assert error.code in [:python_ended, :bad_python_value]

    # A value that arrived before has lost its pages.
    receive do
      %Tensor{data: data} -> assert :binary.last(data) in [0, 7]
    after
      0 -> :ok
    end
  end
end
