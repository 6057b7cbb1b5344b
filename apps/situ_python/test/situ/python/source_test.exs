defmodule Situ.Python.SourceTest do
  use ExUnit.Case, async: true
  import Situ.PythonPrograms

  @moduletag :tmp_dir
  @moduletag capture_log: true

  test "emits what a generator yields, and completes at its end", %{tmp_dir: dir} do
    source =
      write_part(dir, """
      def setup(self, count):
          self.count = count

      def produce(self):
          for number in range(self.count):
              yield {"number": number} if number % 2 else [{"number": number, "text": "even"}]
          yield None
      """)

    test = self()

    {:ok, report} =
      Situ.Pipeline.run(fn p ->
        out = [number: :integer, text: :string]
        part = Situ.Python.source(p, source, options: [count: 500], out: out)
        Situ.each(part.text, &send(test, &1))
        Situ.each(part.number, &send(test, {&1, &2.originating_time}))
      end)

    assert report.errors == []
    received = for number <- 0..499, do: assert_receive({^number, _time})
    times = Enum.map(received, &elem(&1, 1))
    assert times == times |> Enum.sort() |> Enum.uniq()
    for _ <- 1..250, do: assert_receive("even")
    refute_receive "even", 0
  end

  test "ends with its pipeline, also while it waits for a value", %{tmp_dir: dir} do
    source =
      write_part(dir, """
      def produce(self):
          for number in range(3):
              yield {"out": [os.getpid(), number]}
          time.sleep(1_000)
      """)

    test = self()

    {:ok, p} =
      Situ.Pipeline.start(fn p ->
        p |> Situ.Python.source(source) |> Situ.each(&send(test, &1))
      end)

    process = for number <- 0..2, do: assert_receive([_process, ^number])
    {:ok, _report} = Situ.Pipeline.stop(p)
    await_end(process |> hd() |> hd())
  end

  test "fails with the traceback of its generator", %{tmp_dir: dir} do
    source =
      write_part(dir, """
      def produce(self):
          yield {"out": 1}
          raise ValueError("no camera")
      """)

    test = self()

    {:error, failure} =
      Situ.Pipeline.run(fn p -> p |> Situ.Python.source(source) |> Situ.each(&send(test, &1)) end)

    error = if is_struct(failure, Situ.Error), do: failure, else: failure.error
    assert error.what =~ "ValueError: no camera"
    assert error.why =~ "in produce"
    assert_receive 1
  end

  test "list_classes/2 describes the components of a file", %{tmp_dir: dir} do
    source = write_part(dir, "def produce(self):\n    yield None")
    path = String.replace_suffix(source, ":Part", "")

    File.write!(
      path,
      File.read!(path) <>
        """
        class Faces(situ.Component):
            outputs = {"faces": "list", "count": "integer"}

            def setup(self, threshold, size=(1, 2)):
                print("hello")

            def on_image(self, image, message):
                return None

        print("noise")
        """
    )

    assert {:ok, [part, faces]} = Situ.Python.list_classes(path)

    assert %{
             "name" => "Part",
             "generates" => true,
             "outputs" => [["out", "any"]],
             "options" => []
           } = part

    assert faces == %{
             "name" => "Faces",
             "generates" => false,
             "inputs" => ["image"],
             "outputs" => [["faces", "list"], ["count", "integer"]],
             "options" => [
               %{"name" => "threshold", "default" => nil},
               %{"name" => "size", "default" => "(1, 2)"}
             ]
           }

    File.write!(path, "import no_such_module")
    assert {:error, error} = Situ.Python.list_classes(path)
    assert error.why =~ "no module 'no_such_module'"
  end
end
